# SPDX-License-Identifier: Apache-2.0
"""Measuring in the viewer: two clicks on a surface, and the distance between them with its accuracy."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from skymoor.results.read import Result
from skymoor.results.viewer.measure import Measurement, Picker, RelativeErrors, measured, worst_errors
from skymoor.results.viewer.surfaces import MODEL, Layer
from skymoor.types import Array

HINT = "Click two points of the model surface."
COLOUR = (230, 30, 90)
MARK_M = 0.25
LIFT = 0.01  # of the distance, by which the line is drawn above its ends, or the ground between would hide it


class MeasurePanel:
    """A checkbox that makes clicks measure, and what they found."""

    def __init__(self, server: Any, result: Result, surfaces: Callable[[], list[Layer]]) -> None:
        self._server, self._result, self._surfaces = server, result, surfaces
        self._picker = Picker()
        self._points: list[Array] = []
        self._outside = False
        self._drawn: list[Any] = []
        with server.gui.add_folder("Measure"):
            self._box = server.gui.add_checkbox("distance", initial_value=False)
            self._words = server.gui.add_markdown(HINT, visible=False)
        self._box.on_update(lambda _: self._switch())

    @cached_property
    def _errors(self) -> RelativeErrors | None:
        return worst_errors(self._result)

    def _switch(self) -> None:
        self._words.visible, self._words.content = self._box.value, HINT
        self._clear()
        if self._box.value:
            self._server.scene.on_click()(self._click)
        else:
            self._server.scene.remove_click_callback()

    def _click(self, event: Any) -> None:
        layers = self._surfaces()
        model = [one for one in layers if one.name == MODEL]
        point = self._picker.hit(event.ray_origin, event.ray_direction, model)
        outside = point is None
        if point is None:
            point = self._picker.hit(event.ray_origin, event.ray_direction, [x for x in layers if x.name != MODEL])
        if point is None:
            self._words.content = f"There is no surface there. {HINT}"
            return
        if len(self._points) != 1:
            self._clear()
        self._outside = self._outside or outside
        self._points.append(point)
        self._mark(point)
        if len(self._points) == 2:
            start, end = self._points
            found = measured(start, end, None if self._outside else self._errors)
            self._words.content = words_of(found)
            self._join(found)
        else:
            self._words.content = "Click the second point."

    def _clear(self) -> None:
        for handle in self._drawn:
            handle.remove()
        self._drawn, self._points, self._outside = [], [], False

    def _mark(self, point: Array) -> None:
        name = f"/measure/{len(self._points)}"
        self._drawn.append(self._server.scene.add_icosphere(name, MARK_M, color=COLOUR, position=tuple(point)))

    def _join(self, found: Measurement) -> None:
        ends = np.array(self._points, np.float32)[None] + np.array([0, 0, MARK_M + LIFT * found.distance_m], np.float32)
        scene = self._server.scene
        line = scene.add_line_segments("/measure/line", ends, COLOUR, thickness=3.0, thickness_units="screen")
        middle = tuple(ends[0].mean(axis=0).tolist())
        self._drawn += [line, scene.add_label("/measure/label", short_words(found), position=middle)]


def short_words(found: Measurement) -> str:
    """Such as 12.34 m ± 0.11 m (90 %)."""
    error = "" if found.error_90_m is None else f" ± {found.error_90_m:.2f} m (90 %)"
    return f"{found.distance_m:.2f} m{error}"


def words_of(found: Measurement) -> str:
    """The same with its parts, as Markdown."""
    lines = [f"**{short_words(found)}**", f"in plan {found.horizontal_m:.2f} m, in height {found.height_m:+.2f} m"]
    if found.error_90_m is None:
        lines.append("The accuracy is not known: outside the model, without confirmed heights, or of an old run.")
    return "\n\n".join(lines)
