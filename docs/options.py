# SPDX-License-Identifier: Apache-2.0
"""Fills the page of options from the options themselves, so that it cannot be out of date: a hook of mkdocs."""

from __future__ import annotations

from dataclasses import is_dataclass
from typing import Any

from skymoor.pipeline.option_docs import descriptions_of
from skymoor.pipeline.option_parser import option_fields

MARK = "<!-- options -->"


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by mkdocs for each page."""
    if MARK not in markdown:
        return markdown
    from skymoor.pipeline.options import Options

    return markdown.replace(MARK, "\n".join(_sections(Options())))


def _sections(options: Any) -> list[str]:
    """A table for each stage; the groups of a stage follow in it."""
    lines: list[str] = []
    for item in option_fields(options):
        value = getattr(options, item.name)
        if is_dataclass(value):
            lines += ["", f"## {item.name}", "", "| option | default | what it is |", "|---|---|---|"]
            lines += _rows(value, f"{item.name}.")
    return lines


def _rows(group: Any, prefix: str) -> list[str]:
    told, lines, inside = descriptions_of(type(group)), [], []
    for item in option_fields(group):
        value, name = getattr(group, item.name), prefix + item.name
        if is_dataclass(value):
            inside += _rows(value, f"{name}.")
        else:
            text = told.get(item.name, "").replace("|", "\\|").replace("<", "&lt;")
            lines.append(f"| `{name}` | {_spelt(value)} | {text} |")
    return [*lines, *inside]


def _spelt(value: object) -> str:
    return "none" if value is None else f"`{value}`" if str(value) else "empty"
