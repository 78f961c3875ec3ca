# SPDX-License-Identifier: Apache-2.0
"""A finished run as a notebook shows it: the verdict in words, a table, and the map where plotly is installed."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

from skymoor.errors import SkymoorError
from skymoor.results.read import Result
from skymoor.results.report.table import summary_html
from skymoor.results.report.words import height_words, plain_words, verdict

MAP_PIXELS = 3e5  # of its images: the notebook keeps them


def result_html(result: Result) -> str:
    """HTML that needs no network and no kernel; plotly's script is in it, 5 MB."""
    lines = "".join(f"<li>{line}</li>" for line in _lines(result))
    words = f"<p><strong>{escape(_headline(result))}</strong></p><ul>{lines}</ul>"
    return f"<div>{words}{summary_html(result.summary)}{_map(result)}</div>"


def _headline(result: Result) -> str:
    placed = sum(one.registered for one in result.components)
    lost = sum(not one["components"] for one in result.summary["sets"])
    count = len(result.components) + lost
    if not placed:
        return "Not registered: no position was accepted."
    if placed == count:
        return "Registered: every component has an accepted position."
    return f"Registered in part: {placed} of {count} components have an accepted position."


def _lines(result: Result) -> Iterator[str]:
    """One for each component, and one for each set without any."""
    for one in result.components:
        told = plain_words(one)
        words = f"{told} {height_words(one)}".rstrip() if told else verdict(one)
        yield f"{escape(one.name)}: {escape(words)}"
    for image_set in result.summary["sets"]:
        if not image_set["components"]:
            reason = image_set.get("reason") or "no reason was given"
            yield f"{escape(str(image_set['set']))}: {escape(f'Refused: {reason}.')}"


def _map(result: Result) -> str:
    """The map of the cameras; empty where none has a position, plotly is missing, or files of the run are damaged."""
    from skymoor.results.report.plots import cameras_figure  # here, since it loads OpenCV and GDAL

    try:
        if not result.registered_cameras:
            return ""
        figure = cameras_figure(result, max_pixels=MAP_PIXELS)
        page: str = figure.to_html(full_html=False, include_plotlyjs=True, default_height="520px")
    except (SkymoorError, OSError):  # the words and the table are there all the same
        return ""
    return page
