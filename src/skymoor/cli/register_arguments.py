# SPDX-License-Identifier: Apache-2.0
"""Arguments of the command that registers a model of another program."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from skymoor.cli.short import Out, Quiet, Verbose


@dataclass(frozen=True, kw_only=True)
class Register:
    """Lay a reconstruction, cloud, mesh, splat or orthophoto that exists already on the map.

    For example:

    skymoor register odm/project --ortho ortho.tif --dsm dsm.tif --vertical-datum EPSG:3855 --ce90 2.1 --le90 3.8
    --out result

    skymoor register flight.tif flight_dsm.tif --ortho ortho.tif --dsm dsm.tif --accuracy unknown --out result

    Its own files, moved to their places, are in the folder placed of the result; docs/your-models.md lists the kinds.
    Exit status: 0 it is registered, 3 it is not, 2 wrong input or usage, 1 an error of skymoor.
    """

    model: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """A project's folder (COLMAP, ODM, OpenSfM, nerfstudio), or files that share one coordinate system: an orthophoto
    and its DSM, a cloud, a mesh, a splat, cameras."""
    out: Out
    """Folder for the results; the same command again continues where it stopped."""
    photos: Path | None = None
    """Folder of the photos that the model was made from, where they are not beside it."""
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
    """Linear error of the reference, 90 percent, metres; not needed without heights."""
    accuracy: Literal["unknown"] | None = None
    """unknown in place of --ce90 and --le90: positions are then accurate relative to the reference only."""
    reference_run: Path | None = None
    """Folder of an earlier run, whose orthophoto, DSM and accuracy are the reference, in place of all these."""
    area: tuple[float, float, float, float] | None = None
    """Search only there: west, south, east and north in degrees."""
    near: tuple[float, float, float] | None = None
    """Search only there: latitude, longitude and a radius in metres."""
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
    """An option by its dotted name; may be repeated."""
    require_heights: bool = False
    """Exit with 3 also where the model is registered but its heights are not confirmed."""
    seed: int = 0
    """Makes a run repeatable."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""
    json: bool = False
    """For scripts: the result as JSON on stdout, all else on stderr."""
