# SPDX-License-Identifier: Apache-2.0
"""A finished run, and what several formats need of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pycolmap

from skymoor.colmap import component_from_colmap
from skymoor.errors import InputError
from skymoor.export import CameraRow
from skymoor.result import RUN_FIRST, PlacedComponent, Result
from skymoor.types import Component, Progress, no_progress


@dataclass(frozen=True, eq=False)
class Source:
    """A finished run with what several formats need of it; images without a place are left out everywhere."""

    result: Result
    target: Path  # the folder of the format, as it will be called
    notes: list[str] = field(default_factory=list)
    progress: Progress = no_progress

    @cached_property
    def rows(self) -> list[CameraRow]:
        """Cameras with a place."""
        return [row for row in self.result.cameras if row.lat is not None]

    def components(self) -> Iterator[tuple[PlacedComponent, Component]]:
        """Registered components in ENU metres, with the cameras that cameras.csv places in them."""
        for part in self.result.components:
            if part.registered:
                placed = {row.image for row in self.rows if (row.set, row.component) == (part.set, part.index)}
                yield part, _kept(_read_colmap(self.result.folder / "colmap" / part.name), placed)

    def product(self, name: str) -> Path:
        """A file of the run. Raises `InputError` when it is missing."""
        path = self.result.folder / name
        if not path.is_file():
            raise InputError(f"{path}: is missing from the run; {RUN_FIRST}")
        return path


def _read_colmap(folder: Path) -> Component:
    try:
        model = pycolmap.Reconstruction(str(folder))
    except Exception as error:  # COLMAP's own kinds
        raise InputError(f"{folder}: no COLMAP model of the run; {RUN_FIRST}") from error
    names = {image.name: image.name for image in model.images.values()}
    colours = np.array([model.point3D(k).color for k in sorted(model.point3D_ids())], np.uint8).reshape(-1, 3)
    return replace(component_from_colmap(model, names), colours=colours)


def _kept(component: Component, images: set[str]) -> Component:
    """The component less cameras without a place, and less points that fewer than two of the others see."""
    keep = np.array([camera.image in images for camera in component.cameras], bool)
    if keep.all():
        return component
    seen = np.bincount(component.obs_point[keep[component.obs_camera]], minlength=len(component.points)) >= 2
    chosen = keep[component.obs_camera] & seen[component.obs_point]
    return replace(
        component,
        cameras=tuple(camera for camera, kept in zip(component.cameras, keep, strict=True) if kept),
        points=component.points[seen],
        colours=component.colours[seen],
        obs_camera=(np.cumsum(keep) - 1)[component.obs_camera[chosen]].astype(np.int32),
        obs_point=(np.cumsum(seen) - 1)[component.obs_point[chosen]].astype(np.int32),
        obs_px=component.obs_px[chosen],
        centre_covariances=None,
    )
