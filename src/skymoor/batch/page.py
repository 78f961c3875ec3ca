# SPDX-License-Identifier: Apache-2.0
"""The state of a batch: batch.json for programs, and batch.html, one page over all sites."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment

from skymoor import __version__
from skymoor.batch.remote import Address, send_bytes
from skymoor.batch.sites import Outcome, SiteTask
from skymoor.results.report.write import PAGE
from skymoor.store import atomic_file


def write_state(out: Path | Address, tasks: Sequence[SiteTask], outcomes: Sequence[Outcome]) -> Path | Address:
    """Write batch.json and batch.html, each whole or not at all; returns the page.

    Raises `InputError` where they cannot be written.
    """
    ended = sorted(outcomes, key=lambda one: one.name)
    names = {one.name for one in ended}
    waiting = [task.name for task in tasks if task.name not in names]
    rows = [{**asdict(one), "out": str(one.out), "verdict": one.verdict} for one in ended]
    _write(out / "batch.json", json.dumps({"skymoor": __version__, "sites": rows, "waiting": waiting}, indent=1))
    for row, one in zip(rows, ended, strict=True):
        row["report"] = f"{one.name}/{PAGE}" if one.report else ""
    template = (files("skymoor.batch") / "page.html.j2").read_text(encoding="utf-8")
    page = Environment(autoescape=True).from_string(template)
    style = (files("skymoor.results.report") / "page.css").read_text(encoding="utf-8")
    text = page.render(
        title=Path(out).resolve().name,
        style=style,
        ended=rows,
        waiting=waiting,
        count=len(tasks),
        registered=sum(one.verdict == "REGISTERED" for one in ended),
        placed=sum(one.placed for one in ended),
        photos=sum(one.photos for one in ended),
    )
    _write(out / "batch.html", text)
    return out / "batch.html"


def _write(target: Path | Address, text: str) -> None:
    if isinstance(target, Address):
        send_bytes(text.encode(), target)
        return
    with atomic_file(target) as file:
        file.write(text.encode())
