# SPDX-License-Identifier: Apache-2.0
"""Arguments of each command; the texts under the fields are their help."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from skymoor.cli.short import Out, Quiet, Verbose
from skymoor.pipeline.stopping import StopAfter
from skymoor.simulate.options import SiteOptions


@dataclass(frozen=True, kw_only=True)
class Run:
    """Register the photos of a site: positions on Earth with their accuracy.

    For example:

    skymoor run site.toml --out result

    skymoor run site.toml --out result --dry-run

    skymoor run --airborne photos --ground walk --ortho ortho.tif --dsm dsm.tif --vertical-datum EPSG:3855 --ce90 2.1
    --le90 3.8 --out result

    skymoor run site.toml --out result --set model.kind=nerf --set match.max_height_m=150

    Exit status: 0 everything is registered, 3 something is not (or, with --require-heights, has no
    confirmed heights), 2 wrong input or usage, 1 an error of skymoor.
    """

    site: Annotated[Path | None, tyro.conf.Positional] = None
    """site.toml, or its folder; or give --airborne or --ground, --ortho and, where there is one, --dsm."""
    out: Out
    """Folder for the results; the same command again continues where it stopped."""
    airborne: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder of airborne photos, with its sub-folders, or a video; may be repeated: all are one set."""
    ground: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder of ground photos, or a video; may be repeated: each is a set of its own. Without airborne photos, ground
    photos are registered straight to the reference."""
    fps: float | None = None
    """Frames per second of videos that are looked at (6): sharp ones that overlap by 70 to 90 percent are kept."""
    ortho: str | None = None
    """Satellite orthophoto, any CRS that GDAL reads; or its address, of which the part in --area or --near is fetched
    once."""
    dsm: float | str | None = None
    """Its digital surface model (DSM) or the address of one, or one height of the ground in metres; without it heights
    stay unknown."""
    vertical_datum: str | None = None
    """Vertical datum of these heights: "ellipsoid" or an EPSG code such as "EPSG:3855"."""
    ce90: float | None = None
    """Circular error of the reference, 90 percent, metres."""
    le90: float | None = None
    """Linear (vertical) error of the reference, 90 percent, metres; not needed without heights."""
    accuracy: Literal["unknown"] | None = None
    """unknown in place of --ce90 and --le90: positions are then accurate relative to the reference only."""
    reference_run: Path | None = None
    """Folder of an earlier run, whose orthophoto, DSM and accuracy are the reference, in place of all these."""
    area: tuple[float, float, float, float] | None = None
    """Search only there: west, south, east and north in degrees."""
    near: tuple[float, float, float] | None = None
    """Search only there: latitude, longitude and a radius in metres."""
    heading: str | None = None
    """Compass direction, within 20 degrees, in which the first photo looks, or its upper edge if it looks straight
    down; of another photo as PHOTO=DEGREES."""
    height: float | None = None
    """Flying height above the ground in metres, within a quarter."""
    control: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Surveyed points, known camera positions or scale bars, which the models are compared with: gcp_list.txt or
    geo.txt of ODM, or a table; may be repeated."""
    control_ce90: float | None = None
    """Circular error of control, 90 percent, metres, where its files do not say."""
    control_le90: float | None = None
    """Linear error of its heights, 90 percent, metres, where its files do not say."""
    control_datum: str | None = None
    """Vertical datum of its heights: "ellipsoid" or an EPSG code."""
    use_control: bool = False
    """Move the models onto control; otherwise they are compared with it."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """An option by its dotted name, for example --set match.max_height_m=150; may be repeated."""
    require_heights: bool = False
    """Exit with 3 also where a component is registered but its heights are not confirmed."""
    seed: int = 0
    """Makes a run repeatable."""
    stop_after: StopAfter | None = None
    """End after a step; the same command without it goes on from there: reconstruct (models of all photos), depth (also
    depth maps), search (also where in the reference the models may lie)."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""
    dry_run: bool = False
    """Check all input and print the steps with estimates of time and memory; write nothing."""
    json: bool = False
    """For scripts: the result as JSON on stdout, all else on stderr."""


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Fetch the reference of a place: orthophoto and DSM, and the table [reference] of a site.toml.

    For example:

    skymoor reference --bbox 7.43 46.94 7.45 46.96 --ortho https://stac.example.org/collections/orthophoto --dsm
    https://stac.example.org/collections/surface --pixel 0.5 --out bern

    skymoor reference --bbox 7.43 46.94 7.45 46.96 --ortho "https://tiles.example.org/{z}/{x}/{y}.png" --out bern

    A source is a file, the address of a raster (https://, s3://), of a STAC item, collection or search (#NAME chooses
    the asset), of a tile service with {x}, {y} and {z}, or WMTS:ADDRESS. docs/references.md lists sources.
    """

    bbox: tuple[float, float, float, float] | None = None
    """West, south, east and north in WGS 84 degrees; everything without it."""
    ortho: str
    """Source of the orthophoto."""
    dsm: str | None = None
    """Source of the DSM, which is cut as the orthophoto is; without it heights stay unknown."""
    out: Out
    """Folder for ortho.tif, dsm.tif and reference.toml."""
    pixel: float | None = None
    """Metres: an overview of the orthophoto whose pixel is not larger is enough; level of a tile service (0.6)."""
    date: str | None = None
    """Of STAC items, such as 2022 or 2021-04-01/2022-10-31; the newest counts."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""


@dataclass(frozen=True)
class Index:
    """Prepare a large reference for fast searches: its local features are found once and kept beside it.

    For example: skymoor index ortho.tif
    """

    reference: Annotated[Path, tyro.conf.Positional]
    """The orthophoto, or a site.toml that names it."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""


@dataclass(frozen=True)
class Evaluate:
    """Compare a finished run with true camera positions.

    For example: skymoor evaluate result --truth truth.csv
    """

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    truth: Path
    """truth.csv: image,lat,lon,height."""
    json: bool = False
    """For scripts: the rows as JSON on stdout."""


@dataclass(frozen=True)
class Bench:
    """Measure the search and the matcher on a published data set of image pairs that you have on disk.

    For example: skymoor bench srif SRIF --out bench

    A row per pair goes to srif.jsonl; the same command again continues where it stopped. The summary is srif.json.
    """

    dataset: Annotated[Literal["srif"], tyro.conf.Positional]
    """srif: images by night, in infrared and of depth, docs/benchmarks.md says where it is from."""
    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the data set, which has a folder for each kind."""
    out: Out = Path("skymoor-bench")
    """Folder for the results."""
    json: bool = False
    """For scripts: the results as JSON on stdout."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write a finished run in other programs' formats; the photos themselves are never changed."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    to: Annotated[tuple[str, ...], tyro.conf.UseAppendAction]
    """Formats, separated by commas: colmap, nerfstudio, laz, copc, cog, geojson, gpkg, geoparquet, kml, ply,
    gltf, 3dtiles, stac, odm, tum, metashape, realityscan, opf, splat-training, exif, or all."""
    out: Out
    """Folder for the exports; each format gets a folder of its own in it."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""


@dataclass(frozen=True)
class Report:
    """Write report.html of a finished run again.

    For example: skymoor report result --pdf
    """

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    pdf: bool = False
    """Also report.pdf, printed by Chromium, Chrome or Edge."""


@dataclass(frozen=True)
class View:
    """Open a finished run in the 3D viewer: needs skymoor[view]."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    port: int = 8080
    """Port of the viewer on this machine; if it is taken, the next free one."""
    open: bool = True
    """Do not open the browser, only print the address."""


@dataclass(frozen=True)
class Clean:
    """Delete the cache of a run, which keeps its results; the same run would compute everything again."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""


@dataclass(frozen=True, kw_only=True)
class Simulate:
    """Simulate a site with exact truth: photos, orthophoto, DSM, site.toml, truth.csv.

    For example: skymoor simulate --preset industrial --seed 7 --out site
    """

    out: Out
    """Folder for the site; the same command again continues where it stopped."""
    options: tyro.conf.OmitArgPrefixes[SiteOptions] = field(default_factory=SiteOptions)
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Simulate a small site, register its photos, and compare with the truth."""

    out: Out = Path("skymoor-demo")
    """Folder for the site and the results; a second run reuses them."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""
