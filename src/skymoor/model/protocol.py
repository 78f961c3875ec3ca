# SPDX-License-Identifier: Apache-2.0
"""A model that can be rendered, and what builds it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from skymoor.types import Array, Component, DepthMap, Progress, Render, View


class SceneModel(Protocol):
    """A surface in the `level` frame with the photos' colours."""

    @property
    def surface_points(self) -> Array:
        """Points (n, 3) spread over the surface: they say what a view must cover."""

    @property
    def pixel(self) -> float:
        """Size of a photo's pixel on the surface, in level units: finer renders show nothing more."""

    def render(self, view: View, *, progress: Progress) -> Render:
        """Colour, xyz and confidence of each ray of an orthographic view."""


class SceneBuilder(Protocol):
    """Makes a model of a levelled component from its depth maps."""

    def __call__(
        self, component: Component, depths: Sequence[DepthMap], *, progress: Progress, checkpoint: Path | None = None
    ) -> SceneModel:
        """Build the model; long work may be kept in the file `checkpoint`, is taken up from it and removes it."""
