# SPDX-License-Identifier: Apache-2.0
"""A hook of mkdocs: fills in options, acceptance criteria and the version from the code, to keep them up to date."""

from __future__ import annotations

import re
from dataclasses import is_dataclass
from functools import cache, reduce
from typing import Any

from skymoor import __version__
from skymoor.pipeline.option_docs import descriptions_of
from skymoor.pipeline.option_parser import option_fields, option_names

OPTIONS_MARK, CRITERIA_MARK, VERSION_MARK = "<!-- options -->", "<!-- criteria -->", "<!-- version -->"
SCOPES = {
    "airborne": "Airborne photos",
    "walls": "Ground photos, method `walls`",
    "tiles": "Ground photos, methods `cascade` and `exhaustive`",
    "map": "Ground photos without airborne ones",
    "ground": "Ground photos, any method",
}
"""Titles of the tables of criteria, in their order on the page."""


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by mkdocs for each page."""
    if OPTIONS_MARK in markdown:
        from skymoor.pipeline.options import Options

        markdown = markdown.replace(OPTIONS_MARK, "\n".join(_option_tables(Options())))
    if CRITERIA_MARK in markdown:
        markdown = markdown.replace(CRITERIA_MARK, "\n".join(_criterion_tables()))
    return markdown.replace(VERSION_MARK, __version__)


def _option_tables(options: Any) -> list[str]:
    """A table for each stage; the groups of a stage follow in it."""
    lines: list[str] = []
    for item in option_fields(options):
        value = getattr(options, item.name)
        if is_dataclass(value):
            lines += ["", f"### {item.name}", "", "| option | default | meaning |", "|---|---|---|"]
            lines += _rows(value, f"{item.name}.")
    return lines


def _rows(group: Any, prefix: str) -> list[str]:
    described, lines, inside = descriptions_of(type(group)), [], []
    for item in option_fields(group):
        value, name = getattr(group, item.name), prefix + item.name
        if is_dataclass(value):
            inside += _rows(value, f"{name}.")
        else:
            lines.append(f"| `{name}` | {_spelt(value)} | {_cell(described.get(item.name, ''))} |")
    return [*lines, *inside]


def _spelt(value: object) -> str:
    return "none" if value is None else f"`{value}`" if str(value) else "empty"


def _criterion_tables() -> list[str]:
    """A table for each scope."""
    from skymoor.registration.criteria import KINDS

    lines: list[str] = []
    for scope, title in SCOPES.items():
        lines += ["", f"## {title}", "", "| criterion | reason reported | meaning | limit | remedy |"]
        lines += ["|---|---|---|---|---|"]
        for name, kind in KINDS.items():
            if scope in kind.scopes:
                reason = re.sub(r"{[^}]*}", "…", kind.refusal)
                texts = (reason, kind.meaning, _with_defaults(kind.limit), _quoted(kind.remedy))
                lines.append(f"| {kind.name} (`{name}`) | {' | '.join(map(_cell, texts))} |")
    return lines


def _quoted(text: str) -> str:
    """With the names of options as code."""
    return _option_name().sub(r"`\1`", text)


def _with_defaults(text: str) -> str:
    """The same, each with its default."""
    return _option_name().sub(lambda found: f"`{found[1]}` ({_defaults()[found[1]]})", text)


@cache
def _option_name() -> re.Pattern[str]:
    longest_first = sorted(_defaults(), key=len, reverse=True)
    return re.compile(rf"\b({'|'.join(map(re.escape, longest_first))})(?!\w)")


@cache
def _defaults() -> dict[str, object]:
    from skymoor.pipeline.options import Options

    options = Options()
    return {name: reduce(getattr, name.split("."), options) for name in option_names(options)}


def _cell(text: str) -> str:
    """Text for a cell of a table."""
    return text.replace("|", "\\|").replace("<", "&lt;")
