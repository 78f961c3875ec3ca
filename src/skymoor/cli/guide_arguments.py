# SPDX-License-Identifier: Apache-2.0
"""Arguments of the commands that help a person: before the first run, and after a refusal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from skymoor.cli.short import Out, Quiet, Verbose


@dataclass(frozen=True, kw_only=True)
class Init:
    """Look at photos and a reference, and write a commented site.toml for them.

    For example: skymoor init photos --ground walk --ortho ortho.tif --dsm dsm.tif

    What the files do not state is in it as a comment, with usual values. A file that exists is never overwritten.
    """

    photos: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Folders of airborne photos, with their sub-folders, or videos: all are one set."""
    ground: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder of ground photos, or a video; may be repeated: each is a set of its own."""
    ortho: str | None = None
    """Satellite orthophoto, or its address."""
    dsm: float | str | None = None
    """Its digital surface model (DSM) or the address of one, or one height of the ground in metres."""
    vertical_datum: str | None = None
    """Vertical datum of these heights: "ellipsoid" or an EPSG code such as "EPSG:3855"."""
    ce90: float | None = None
    """Circular error of the reference, 90 percent, metres."""
    le90: float | None = None
    """Linear (vertical) error of the reference, 90 percent, metres."""
    accuracy: Literal["unknown"] | None = None
    """unknown in place of --ce90 and --le90."""
    out: Out = Path("site.toml")
    """The file, or its folder."""


@dataclass(frozen=True, kw_only=True)
class Ask:
    """Ask a person where a site lies that was refused, and run it again with the answer.

    For example:

    skymoor ask result

    skymoor ask result --candidate 2

    skymoor ask result --near 47.3769 8.5417 300 --heading 240

    Without an answer among the arguments a page opens in the browser: places side by side, a point or an area on the
    map, a length, or north. The answer bounds the search with its own uncertainty; stages before it come from the
    cache, and all acceptance criteria are checked again. Exit status as of skymoor run.
    """

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    component: str | None = None
    """Which one the answer is about, such as airborne_0; without it the first that is not registered."""
    candidate: int | None = None
    """Number of the place among those that the report lists: 1 is the best."""
    near: tuple[float, float, float] | None = None
    """The site lies there: latitude, longitude and a radius in metres."""
    area: tuple[float, float, float, float] | None = None
    """The site lies there: west, south, east and north in degrees."""
    heading: str | None = None
    """Compass direction, within 20 degrees, in which the first photo looks, or its upper edge if it looks straight
    down; of another photo as PHOTO=DEGREES."""
    north: float | None = None
    """Where north is on the render: degrees clockwise from its upper edge, within 20."""
    height: float | None = None
    """Flying height above the ground in metres, within a quarter."""
    by: str = ""
    """Who answers, for the record."""
    run: bool = True
    """Run the site again with the answer; --no-run only records it in answers.json."""
    port: int = 0
    """Port of the page on this machine; any free one by default."""
    open: bool = True
    """Do not open the browser, only print the address."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""
    json: bool = False
    """For scripts: the result as JSON on stdout, all else on stderr."""
