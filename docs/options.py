# SPDX-License-Identifier: Apache-2.0
"""Fills the page of options from the options themselves, so that it cannot be out of date: a hook of mkdocs."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields, is_dataclass
from typing import Any

MARK = "<!-- options -->"
ENTRY = re.compile(r"^    (\w+(?:, \w+)*): (.*)")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by mkdocs for each page."""
    if MARK not in markdown:
        return markdown
    from skymoor.pipeline.options import Options

    return markdown.replace(MARK, "\n".join(_sections(Options())))


def _sections(options: Any) -> list[str]:
    """A table for each stage; the groups of a stage follow in it."""
    lines: list[str] = []
    for item in fields(options):
        value = getattr(options, item.name)
        if is_dataclass(value):
            lines += ["", f"## {item.name}", "", "| option | default | what it is |", "|---|---|---|"]
            lines += _rows(value, f"{item.name}.")
    return lines


def _rows(group: Any, prefix: str) -> list[str]:
    told, lines, inside = _attributes(type(group)), [], []
    for item in fields(group):
        value, name = getattr(group, item.name), prefix + item.name
        if is_dataclass(value):
            inside += _rows(value, f"{name}.")
        else:
            text = told.get(item.name, "").replace("|", "\\|").replace("<", "&lt;")
            lines.append(f"| `{name}` | {_spelt(value)} | {text} |")
    return [*lines, *inside]


def _spelt(value: object) -> str:
    return "none" if value is None else f"`{value}`" if str(value) else "empty"


def _attributes(kind: type) -> dict[str, str]:
    """What the docstring says of each field."""
    found: dict[str, str] = {}
    names: list[str] = []
    lines = (inspect.getdoc(kind) or "").partition("Attributes:\n")[2].splitlines()
    for line in lines:
        entry = ENTRY.match(line)
        if entry:
            names = entry[1].split(", ")
            found |= dict.fromkeys(names, entry[2])
        elif line.startswith("        "):
            found |= {name: f"{found[name]} {line.strip()}" for name in names}
        else:
            names = []
    return found
