# SPDX-License-Identifier: Apache-2.0
"""What `skymoor` without a command shows: one line or two for each command, in the order in which they are needed."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Mapping

GROUPS = {
    "try it without data": ("demo",),
    "your photos": ("init", "run", "ask", "batch"),
    "a model, cloud or orthophoto that exists": ("register",),
    "a finished run": ("report", "view", "evaluate", "export", "clean"),
    "references": ("reference", "index", "grids"),
    "this program and this machine": ("doctor", "weights", "schema", "completion", "help", "version"),
    "tests of the method": ("simulate", "bench"),
}
BEGIN = """skymoor georegisters 3D models: photos without metadata, an orthophoto and its DSM go in, and every camera
and model gets a position on Earth with its accuracy, or the reason why it has none."""
END = """Begin with skymoor demo. With your own photos: skymoor init PHOTOS --ortho F.tif --dsm F.tif writes a
site.toml, and skymoor run site.toml --out result registers them. skymoor help COMMAND explains a command and all its
options."""
INDENT, WIDEST = 14, 110


def overview(commands: Mapping[str, type]) -> str:
    """All commands by what they are for, as wide as the terminal."""
    width = min(WIDEST, shutil.get_terminal_size().columns)
    lines = ["usage: skymoor COMMAND ...", "", textwrap.fill(" ".join(BEGIN.split()), width)]
    for title, names in GROUPS.items():
        lines += ["", f"{title}:"]
        lines += [_line(name, commands[name], width) for name in names]
    return "\n".join([*lines, "", textwrap.fill(" ".join(END.split()), width)])


def _line(name: str, kind: type, width: int) -> str:
    first = " ".join((kind.__doc__ or "").partition("\n\n")[0].split())
    return textwrap.fill(first, width, initial_indent=f"  {name}".ljust(INDENT), subsequent_indent=" " * INDENT)
