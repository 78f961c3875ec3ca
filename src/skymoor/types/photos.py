# SPDX-License-Identifier: Apache-2.0
"""Photos, and what their reconstruction tells: cameras, calibration, components and gravity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.geometry import Intrinsics, Similarity
from skymoor.types.arrays import Array, Image, Mask


@dataclass(frozen=True)
class Photos:
    """A folder's images: names relative to the site, sizes (width, height), and how to read one as (h, w, 3) RGB.

    `content` stands for all pixels where results are kept; without it they are read for that.
    """

    names: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    read: Callable[[str], Image]
    content: object = None

    def __len__(self) -> int:
        return len(self.names)

    def cache_key(self) -> object:
        """What results that are computed from the photos depend on."""
        return self.names, self.content if self.content is not None else [self.read(name) for name in self.names]


@dataclass(frozen=True, eq=False)
class Camera:
    """A posed image. `cam_from_world` has scale 1; camera axes are x right, y down, z forward."""

    image: str
    intrinsics: Intrinsics
    cam_from_world: Similarity

    @cached_property
    def centre(self) -> Array:
        """Projection centre in the world frame, (3,)."""
        return self.cam_from_world.inverse().translation

    def transformed(self, target_from_world: Similarity) -> Camera:
        """Express the camera in another frame; the similarity's scale moves the centre only."""
        rotation = self.cam_from_world.rotation @ target_from_world.rotation.T
        centre = target_from_world.apply(self.centre)
        return replace(self, cam_from_world=Similarity(1.0, rotation, -rotation @ centre))


@dataclass(frozen=True)
class Calibration:
    """How well the photos alone fix the focal length.

    `focal_low_ratio` and `focal_high_ratio` bound the focal lengths, relative to the estimate, that explain the
    photos about as well (profile of the bundle adjustment's cost). They count as an interval of 90 %: on real and
    simulated blocks the error was a tenth to nine tenths of its half. `uncertain` says that they are wide.
    """

    shared_intrinsics: bool
    focal_px: float
    focal_sigma_ratio: float
    focal_low_ratio: float
    focal_high_ratio: float
    uncertain: bool
    relief_ratio: float | None = None  # by which the reference's relief has changed the focal length

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length."""
        return max((self.focal_high_ratio - self.focal_low_ratio) / 2 / LE90_PER_SIGMA, self.focal_sigma_ratio, 0.0)

    def narrowed(self, ratio: float, sigma: float) -> Calibration:
        """With what another source says: that the focal length is `ratio` times the estimate, up to `sigma` of it.

        The estimate stays: its deviation from `ratio` counts as an error.
        """
        total = float(np.hypot(sigma, ratio - 1))
        return replace(
            self,
            focal_sigma_ratio=total,
            focal_low_ratio=1 - LE90_PER_SIGMA * total,
            focal_high_ratio=1 + LE90_PER_SIGMA * total,
        )


@dataclass(frozen=True, eq=False)
class Component:
    """One connected reconstruction: cameras, points (n, 3), colours (n, 3), and the observations that tie them.

    Observation k says that camera `obs_camera[k]` sees point `obs_point[k]` at pixel `obs_px[k]`. The camera centres'
    covariances (n cameras, 3, 3), where they are known, are of the shape alone, whatever the frame.
    """

    cameras: tuple[Camera, ...]
    points: Array
    colours: Image
    obs_camera: NDArray[np.int32]
    obs_point: NDArray[np.int32]
    obs_px: Array
    reprojection_px: float
    calibration: Calibration | None = None
    centre_covariances: Array | None = None

    @property
    def centres(self) -> Array:
        """Projection centres, (n cameras, 3)."""
        return np.array([camera.centre for camera in self.cameras])

    def of_cameras(self, keep: Mask) -> Component:
        """With those cameras alone of which `keep` (n cameras,) is true, and what they see; all points stay."""
        seen = keep[self.obs_camera]
        return replace(
            self,
            cameras=tuple(camera for camera, kept in zip(self.cameras, keep, strict=True) if kept),
            obs_camera=(np.cumsum(keep) - 1)[self.obs_camera[seen]].astype(np.int32),
            obs_point=self.obs_point[seen],
            obs_px=self.obs_px[seen],
            centre_covariances=None if self.centre_covariances is None else self.centre_covariances[keep],
        )

    def transformed(self, target_from_world: Similarity) -> Component:
        """Express the component in another frame."""
        cameras = tuple(camera.transformed(target_from_world) for camera in self.cameras)
        covariances = self.centre_covariances
        if covariances is not None:
            turn = target_from_world.scale * target_from_world.rotation
            covariances = turn @ covariances @ turn.T
        points = target_from_world.apply(self.points)
        return replace(self, cameras=cameras, points=points, centre_covariances=covariances)


@dataclass(frozen=True, eq=False)
class Gravity:
    """Up in the component's frame, with its estimated error and how it was found."""

    up: Array
    sigma_deg: float
    plane_height: float  # of the ground plane along `up`, in component units
    camera_height: float  # median height of the cameras above that plane, in component units
    method: str
    disagreement_deg: float  # between the ground plane's normal and the cameras' horizon
