# SPDX-License-Identifier: Apache-2.0
"""PYTHONPATH=docs python -m gallery RUN [--out docs/images] [--only NAME ...]

RUN is the folder of a finished run. The pictures of a refusal and of the terminal need the site beside it, as
`skymoor demo` leaves it (RUN/../site/site.toml). What a run has not, is left out and named.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from gallery.others import notebook, odm
from gallery.pages import ask, report, report_phone, report_print
from gallery.rasters import overlay, overview, residuals, simulated, walls
from gallery.run import Missing, Source
from gallery.terminal import terminal
from gallery.viewer import viewer, viewer_measure

Picture = Callable[[Source, Path], None]
PICTURES: dict[str, Picture] = {
    "report.jpg": report,
    "report_phone.jpg": report_phone,
    "report_print.jpg": report_print,
    "overview.jpg": overview,
    "overlay.jpg": overlay,
    "residuals.jpg": residuals,
    "walls.jpg": walls,
    "simulated.jpg": simulated,
    "viewer.jpg": viewer,
    "viewer_measure.jpg": viewer_measure,
    "ask.jpg": ask,
    "notebook.jpg": notebook,
    "odm.jpg": odm,
    "terminal.svg": terminal,
}
"""What is made, by its name in docs/images."""


def main() -> int:
    """Make the pictures; returns how many were left out."""
    parser = argparse.ArgumentParser(description="Make the pictures of the documentation from a finished run")
    parser.add_argument("run", type=Path)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent.parent / "images")
    parser.add_argument("--only", nargs="+", choices=PICTURES, default=tuple(PICTURES), metavar="NAME")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    left_out = 0
    with Source(given.run) as source:
        for name in given.only:
            try:
                PICTURES[name](source, given.out / name)
                print(f"{given.out / name}: {(given.out / name).stat().st_size // 1000} kB")
            except Missing as error:
                left_out += 1
                print(f"{name}: left out: {error}", file=sys.stderr)
    return left_out


if __name__ == "__main__":
    sys.exit(1 if main() else 0)
