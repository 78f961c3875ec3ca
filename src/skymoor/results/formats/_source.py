# SPDX-License-Identifier: Apache-2.0
"""A finished run, and what several formats need of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pycolmap

from skymoor.engines.colmap import component_from_colmap
from skymoor.errors import InputError
from skymoor.geometry import Intrinsics
from skymoor.results.read import RUN_FIRST, ComponentSummary, Result
from skymoor.results.tables import CameraRow
from skymoor.types import Component, Progress, no_progress

ELLIPSOID = "metres above the WGS 84 ellipsoid"


@dataclass(frozen=True, eq=False)
class Source:
    """A finished run with what several formats need of it; images without a position are left out everywhere."""

    result: Result
    target: Path  # the folder of the format, as it will be called
    notes: list[str] = field(default_factory=list)
    progress: Progress = no_progress
    models: dict[str, Component] = field(default_factory=dict)  # read once for all formats

    @property
    def rows(self) -> tuple[CameraRow, ...]:
        """Cameras with a position."""
        return self.result.registered_cameras

    @property
    def without_heights(self) -> bool:
        """Whether heights of some registered component are not confirmed."""
        return any(part.heights == "NOT_CONFIRMED" for part in self.result.components if part.registered)

    def components(self) -> Iterator[tuple[ComponentSummary, Component]]:
        """Registered components in ENU metres, with the cameras that cameras.csv lists for them."""
        for part in self.result.components:
            if part.registered:
                if part.name not in self.models:
                    registered = {row.image for row in self.rows_of(part)}
                    self.models[part.name] = _kept(_component(self.result.model(part)), registered)
                yield part, self.models[part.name]

    def rows_of(self, part: ComponentSummary) -> list[CameraRow]:
        """The cameras of a component with a position."""
        return [row for row in self.rows if (row.set, row.component) == (part.image_set, part.index)]

    def lenses(self) -> dict[str, Intrinsics]:
        """Of the photos of all registered components, by image."""
        return {camera.image: camera.intrinsics for _, part in self.components() for camera in part.cameras}

    @property
    def finished(self) -> datetime:
        """When the run was finished: when its summary was written."""
        return datetime.fromtimestamp((self.result.folder / "summary.json").stat().st_mtime, UTC)

    @property
    def day(self) -> str:
        """The same as YYYY-MM-DD."""
        return self.finished.date().isoformat()

    def product(self, name: str) -> Path:
        """A file of the run. Raises `InputError` when it is missing."""
        path = self.result.folder / name
        if not path.is_file():
            raise InputError(f"{path}: is missing from the run; {RUN_FIRST}")
        return path


def _component(model: pycolmap.Reconstruction) -> Component:
    names = {image.name: image.name for image in model.images.values()}
    colours = np.array([model.point3D(k).color for k in sorted(model.point3D_ids())], np.uint8).reshape(-1, 3)
    return replace(component_from_colmap(model, names), colours=colours)


def _kept(component: Component, images: set[str]) -> Component:
    """The component without cameras that have no position, and without points that fewer than two of the others see."""
    keep = np.array([camera.image in images for camera in component.cameras], bool)
    if keep.all():
        return component
    kept = component.of_cameras(keep)
    seen = np.bincount(kept.obs_point, minlength=len(kept.points)) >= 2
    chosen = seen[kept.obs_point]
    return replace(
        kept,
        points=kept.points[seen],
        colours=kept.colours[seen],
        obs_camera=kept.obs_camera[chosen],
        obs_point=(np.cumsum(seen) - 1)[kept.obs_point[chosen]].astype(np.int32),
        obs_px=kept.obs_px[chosen],
    )
