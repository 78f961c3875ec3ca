# SPDX-License-Identifier: Apache-2.0
"""Protocols of scene models and of their builders."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from skymoor.types import Array, Component, DepthMap, Progress, Render, View


class SceneModel(Protocol):
    """A surface in the `level` frame with the photos' colours."""

    @property
    def surface_points(self) -> Array:
        """Points (n, 3) distributed over the surface, from which the extent of a view follows."""

    @property
    def pixel(self) -> float:
        """Ground sampling distance of the photos in level units: finer renders add no detail."""

    def render(self, view: View, *, progress: Progress) -> Render:
        """Colour, xyz and confidence of each ray of an orthographic view."""


class SceneBuilder(Protocol):
    """Builds a model of a levelled component from its depth maps."""

    def __call__(
        self, component: Component, depths: Sequence[DepthMap], *, progress: Progress, checkpoint: Path | None = None
    ) -> SceneModel:
        """Build the model; long computations may resume from the file `checkpoint` and remove it at the end."""
