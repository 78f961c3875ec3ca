# SPDX-License-Identifier: Apache-2.0
"""The command line: parses and prints, nothing else."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from skymoor import __version__
from skymoor.errors import InputError, SkymoorError

EXIT_REGISTERED, EXIT_ERROR, EXIT_USAGE, EXIT_NOT_REGISTERED = 0, 1, 2, 3


@dataclass(frozen=True)
class Run:
    """Place a site's photos on the Earth."""

    site: Annotated[Path | None, tyro.conf.Positional] = None
    """site.toml; or say --airborne, --ortho and --dsm."""
    out: Path = Path("out")
    """Folder for the results; the same command again goes on where it stopped."""
    airborne: Path | None = None
    """Folder of airborne photos."""
    ground: tuple[Path, ...] = ()
    """Folders of ground photos (not placed by this version)."""
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
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = field(default=())
    """An option by its dotted name, for example --set match.cyclic.cycle_px=3; may be repeated."""
    seed: int = 0
    """Makes a run repeatable."""
    quiet: bool = False
    """Plain lines in place of progress bars."""


@dataclass(frozen=True)
class Evaluate:
    """Compare a finished run with true camera positions."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    truth: Path
    """truth.csv: image,lat,lon,height."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        print(__version__)
        return 0
    try:
        chosen = tyro.cli(
            Annotated[Run, tyro.conf.subcommand("run")] | Annotated[Evaluate, tyro.conf.subcommand("evaluate")],  # type: ignore[operator]
            args=arguments,
            prog="skymoor",
            description="skymoor moors floating 3D models to the Earth.",
        )
        from skymoor import commands  # pycolmap, torch and OpenCV load here, not for --help

        if isinstance(chosen, Evaluate):
            commands.evaluate(chosen)
            return EXIT_REGISTERED
        return EXIT_REGISTERED if commands.run(chosen) else EXIT_NOT_REGISTERED
    except InputError as error:
        print(f"skymoor: {error}", file=sys.stderr)
        return EXIT_USAGE
    except SkymoorError as error:
        print(f"skymoor: {error}", file=sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt:
        print("skymoor: stopped; the same command goes on from here", file=sys.stderr)
        return 130
