# SPDX-License-Identifier: Apache-2.0
"""What each command takes; the comments under the fields are its help."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from skymoor.simulate.options import SiteOptions


@dataclass(frozen=True, kw_only=True)
class Run:
    """Place a site's photos on the Earth.

    For example:

    skymoor run site.toml --out result

    skymoor run site.toml --out result --dry-run

    skymoor run --airborne photos --ground walk --ortho ortho.tif --dsm dsm.tif --vertical-datum EPSG:3855 --ce90 2.1
    --le90 3.8 --out result

    skymoor run site.toml --out result --set model.kind=nerf --set match.max_height_m=150

    Exit status: 0 all is registered, 3 something is not, 2 the input is wrong, 1 an error of skymoor's.
    """

    site: Annotated[Path | None, tyro.conf.Positional] = None
    """site.toml; or say --airborne, --ortho and --dsm."""
    out: Path
    """Folder for the results; the same command again goes on where it stopped."""
    airborne: Path | None = None
    """Folder of airborne photos."""
    ground: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder of ground photos; may be repeated."""
    ortho: Path | None = None
    """Satellite orthophoto, any CRS that GDAL reads."""
    dsm: Path | None = None
    """Its surface model, heights in metres."""
    vertical_datum: str | None = None
    """What the DSM's heights refer to: "ellipsoid" or an EPSG code such as "EPSG:3855"."""
    ce90: float | None = None
    """Circular error of the reference, 90 percent, metres."""
    le90: float | None = None
    """Linear (vertical) error of the reference, 90 percent, metres."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """An option by its dotted name, for example --set match.cyclic.cycle_px=3; may be repeated."""
    seed: int = 0
    """Makes a run repeatable."""
    quiet: bool = False
    """Plain lines in place of progress bars."""
    dry_run: bool = False
    """Check all input and print what would be done, with about how much time and memory; write nothing."""
    json: bool = False
    """For scripts: the result as JSON on stdout, all else on stderr."""


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


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write a finished run in the formats of other programs; the photos themselves are never touched."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    to: Annotated[tuple[str, ...], tyro.conf.UseAppendAction]
    """Formats, parted by commas: colmap, nerfstudio, laz, cog, geojson, gpkg, kml, ply, gltf, odm, exif, or all."""
    out: Path
    """Folder for the exports; each format gets a folder of its own in it."""
    quiet: bool = False
    """Plain lines in place of progress bars."""


@dataclass(frozen=True)
class Report:
    """Write report.html, the page about a finished run, again."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""


@dataclass(frozen=True)
class View:
    """Look at a finished run in three dimensions: needs skymoor[view]."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    port: int = 8080
    """Of the viewer on this machine; the next free one is taken if it is not free."""
    open: bool = True
    """Open the browser; --no-open only says the address."""


@dataclass(frozen=True)
class Clean:
    """Delete the cache of a run, which keeps its results; the same run would compute everything again."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""


@dataclass(frozen=True)
class Schema:
    """Print the JSON schema of site.toml, for editors that complete and check it.

    For example: skymoor schema > site.schema.json
    """


@dataclass(frozen=True, kw_only=True)
class Simulate:
    """Make a site with exact truth: photos, orthophoto, DSM, site.toml, truth.csv.

    For example: skymoor simulate --preset industrial --seed 7 --out site
    """

    out: Path
    """Folder for the site; the same command again goes on where it stopped."""
    options: tyro.conf.OmitArgPrefixes[SiteOptions] = field(default_factory=SiteOptions)
    quiet: bool = False
    """Plain lines in place of progress bars."""


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Simulate a small site, place its photos on the Earth, and compare with the truth."""

    out: Path = Path("skymoor-demo")
    """Folder for the site and the results; a second run shows the results at once."""
    quiet: bool = False
    """Plain lines in place of progress bars."""


@dataclass(frozen=True)
class Doctor:
    """Look whether this machine has what runs need: versions, GPU, memory, disk, weights."""

    out: Path = Path()
    """Where results are going to be written."""
    json: bool = False
    """For scripts: as JSON on stdout."""


@dataclass(frozen=True)
class Completion:
    """Print a script that completes commands and options with the tab key.

    For example: skymoor completion bash > ~/.local/share/bash-completion/completions/skymoor
    """

    shell: Annotated[Literal["bash", "zsh", "tcsh"], tyro.conf.Positional]


@dataclass(frozen=True)
class WeightsList:
    """Show the pretrained weights that are known, their licences, and which of them are here."""

    json: bool = False
    """For scripts: as JSON on stdout."""


@dataclass(frozen=True)
class WeightsFetch:
    """Download pretrained weights and check them.

    For example: skymoor weights fetch aliked
    """

    name: Annotated[str, tyro.conf.Positional]
    """As in the list."""
    to: Path | None = None
    """Folder of all weights: $SKYMOOR_WEIGHTS or the user's folder of data unless said."""
    quiet: bool = False
    """Plain lines in place of progress bars."""


@dataclass(frozen=True)
class Weights:
    """Pretrained weights of optional engines; nothing is downloaded unless it is asked for here."""

    action: (
        Annotated[WeightsList, tyro.conf.subcommand("list", prefix_name=False)]
        | Annotated[WeightsFetch, tyro.conf.subcommand("fetch", prefix_name=False)]
    )
