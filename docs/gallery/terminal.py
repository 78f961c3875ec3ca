# SPDX-License-Identifier: Apache-2.0
"""A picture of the terminal in the middle of a run, as SVG with the letters of the reader."""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path

from rich.console import Console
from rich.text import Text

from gallery.run import Missing, Source, on_terminal

CODE = re.compile(r"\x1b\[([0-9;?]*)([A-Za-z])|(\r\n|\n|\r)|([^\x1b\r\n]+)|\x1b.?")
WIDTH, LINES = 100, 16
UNTIL_S, BARS = 110.0, 2
FORMAT = """<svg class="rich-terminal" viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>.{unique_id}-matrix {{ font-family: ui-monospace, Menlo, Consolas, "DejaVu Sans Mono", monospace;
font-size: {char_height}px; line-height: {line_height}px }} {styles}</style>
<defs><clipPath id="{unique_id}-clip-terminal">
<rect width="{terminal_width}" height="{terminal_height}"/></clipPath>{lines}</defs>
{chrome}<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">{backgrounds}
<g class="{unique_id}-matrix">{matrix}</g></g></svg>
"""
"""Of rich, without its fonts from the network."""


def terminal(source: Source, path: Path) -> None:
    """The steps that are done, the bar of the run and that of its current step, of a run that is then stopped."""
    command = [sys.executable, "-m", "skymoor", "run", str(source.site), "--out", str(source.scratch / "begun")]
    frames = frames_of(on_terminal(command, UNTIL_S))
    before = [one for one in frames if not any(line.startswith("stopping") for line in one)]
    lines = next((one for one in reversed(before) if sum("elapsed" in line for line in one) == BARS), None)
    if lines is None:
        raise Missing("the terminal showed no progress")
    console = Console(record=True, width=WIDTH, file=io.StringIO(), force_terminal=True)
    console.print("$ skymoor run site.toml --out result", highlight=False, markup=False)
    for line in lines[-LINES:]:
        console.print(Text.from_ansi(line))
    path.write_text(console.export_svg(title="skymoor run", code_format=FORMAT), encoding="utf-8")


def frames_of(shown: str) -> list[list[str]]:
    """What a terminal showed each time before a line was cleared: its lines, with the codes of their colours.

    It knows what rich's bars need: ends of lines, the cursor up, and lines that are cleared.
    """
    lines, row, found = [""], 0, []
    for code in CODE.finditer(shown):
        number, letter, end, text = code.groups()
        if letter == "A":
            row = max(0, row - int(number or 1))
        elif letter == "K":
            found.append(list(lines))
            lines[row] = ""
        elif letter == "m":
            lines[row] += code.group()
        elif end is not None and "\n" in end:
            row += 1
            lines += [""] * (row + 1 - len(lines))
        elif text is not None:
            lines[row] += text
    return found
