# SPDX-License-Identifier: Apache-2.0
"""Engines that know the truth: each stage can be tested alone, or replaced while another is examined.

An oracle is called like the engine that it replaces. Its fields set the errors of its results. Photos are known by
their names in the simulated site, or, where an engine gets pixels only, by those.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skymoor.errors import InputError
from skymoor.simulate.capture.shots import true_view
from skymoor.simulate.light.photo import true_depth, true_labels
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import GROUND_LABELS, stream
from skymoor.simulate.oracle_pairs import OraclePairMatcher
from skymoor.simulate.site import true_enu_from_sfm
from skymoor.simulate.world import World
from skymoor.types import Camera, Component, DepthMap, Image, Photos, Progress, Raster, Warp, no_progress

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

__all__ = ["OracleDepth", "OracleGroundLabeler", "OracleMatcher", "OracleMonocularDepth", "OraclePairMatcher"]

PATCH_PX = 16


@dataclass(frozen=True)
class OracleDepth:
    """True depth maps of a component in any frame: its cameras are laid on the true ones, then rays are cast.

    Attributes:
        world: the site that the photos are of.
        max_px: long side of the depth maps.
        noise_ratio: standard deviation of a depth, relative to it.
        outlier_share: share of depths that are wrong by up to a half.
        missing_share: share of pixels without a depth, in patches.
        seed: of the errors.
    """

    world: World
    max_px: int = 400
    noise_ratio: float = 0.0
    outlier_share: float = 0.0
    missing_share: float = 0.0
    seed: int = 0

    def __call__(self, component: Component, photos: Photos, *, progress: Progress = no_progress) -> Iterator[DepthMap]:
        """One depth map per camera. Raises `InputError` for a photo that the site does not have."""
        truths = [true_view(self.world, camera.image) for camera in component.cameras]
        enu_from_sfm = true_enu_from_sfm(component, [camera for camera, _ in truths])
        for done, (camera, (_, scene)) in enumerate(zip(component.cameras, truths, strict=True)):
            small, rgb = _undistorted(camera, photos.read(camera.image), self.max_px)
            exact = true_depth(scene, small.transformed(enu_from_sfm)) / np.float32(enu_from_sfm.scale)
            depth = self._erring(exact, stream(self.seed, "depth", camera.image))
            sigma = (max(self.noise_ratio, 1e-3) * depth).astype(np.float32)
            yield DepthMap(small, depth, sigma, np.full(depth.shape, 3, np.uint8), rgb)
            progress(done + 1, len(truths))

    def _erring(self, depth: Array32, rng: np.random.Generator) -> Array32:
        factor = 1 + self.noise_ratio * rng.standard_normal(depth.shape)
        wrong = rng.uniform(size=depth.shape) < self.outlier_share
        factor = np.where(wrong, rng.uniform(0.5, 1.5, depth.shape), factor)
        return np.where(_patches(rng, depth.shape, self.missing_share), np.nan, depth * factor).astype(np.float32)


@dataclass(frozen=True)
class _ByPixels:
    """Finds photos by their pixels; `read` gives those of a name."""

    world: World
    names: tuple[str, ...]
    read: Callable[[str], Image]

    @cached_property
    def _name_by_digest(self) -> dict[str, str]:
        return {_digest(self.read(name)): name for name in self.names}

    def _view(self, image: Image) -> tuple[str, Camera, Scene]:
        name = self._name_by_digest.get(_digest(image))
        if name is None:
            raise InputError("the oracle does not know this picture: give it the photos of the site as they are read")
        return name, *true_view(self.world, name)


@dataclass(frozen=True)
class OracleMonocularDepth(_ByPixels):
    """True z-depth, made relative: zero is near, one far, and the sky is as far as anything; see `MonocularDepth`.

    Attributes:
        noise: standard deviation, where the range of depths is one.
        seed: of the noise.
    """

    noise: float = 0.0
    seed: int = 0

    def __call__(self, image: Image) -> Array32:
        """Relative depth (h, w) of a photo. Raises `InputError` for another picture."""
        name, camera, scene = self._view(image)
        depth = true_depth(scene, camera)
        if not np.isfinite(depth).any():
            return np.ones(depth.shape, np.float32)
        low, high = np.nanpercentile(depth, (2, 98))
        relative = np.clip((depth - low) / max(high - low, 1e-6), -0.1, 1.1)
        noise = self.noise * stream(self.seed, "monocular", name).standard_normal(depth.shape)
        return np.asarray(np.where(np.isnan(relative), 1.1, relative) + noise, dtype=np.float32)


@dataclass(frozen=True)
class OracleGroundLabeler(_ByPixels):
    """Which pixels are ground, pavement or water; see `GroundLabeler`.

    Attributes:
        wrong_share: share of pixels that are labelled wrongly, in patches.
        seed: of the errors.
    """

    wrong_share: float = 0.0
    seed: int = 0

    def __call__(self, image: Image) -> Mask:
        """Ground-like pixels (h, w) of a photo. Raises `InputError` for another picture."""
        name, camera, scene = self._view(image)
        ground = np.isin(true_labels(scene, camera), GROUND_LABELS)
        wrong = _patches(stream(self.seed, "labels", name), ground.shape, self.wrong_share)
        return np.asarray(ground ^ wrong)


@dataclass(frozen=True, eq=False)
class OracleMatcher:
    """Matches two pictures whose pixels' true positions are known.

    Attributes:
        xyz_a, xyz_b: (h, w, 3) positions in one frame, NaN where a picture shows nothing.
        tolerance: positions farther apart than this are different places, in units of the frame.
        noise_px: standard deviation of the results.
        outlier_share: share of results that are drawn at random, with full confidence.
        seed: of the errors.
    """

    xyz_a: Array32
    xyz_b: Array32
    tolerance: float = 0.5
    noise_px: float = 0.0
    outlier_share: float = 0.0
    seed: int = 0

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match both ways. Raises `ValueError` when the pictures are not those that the positions are of."""
        if a.rgb.shape[:2] != self.xyz_a.shape[:2] or b.rgb.shape[:2] != self.xyz_b.shape[:2]:
            raise ValueError(f"positions of {self.xyz_a.shape} and {self.xyz_b.shape} are of other pictures")
        b_from_a, confidence_a = self._one_way(self.xyz_a, self.xyz_b, a.mask, b.mask, "b_from_a")
        a_from_b, confidence_b = self._one_way(self.xyz_b, self.xyz_a, b.mask, a.mask, "a_from_b")
        return Warp(b_from_a, confidence_a, a_from_b, confidence_b)

    def _one_way(
        self, source: Array32, target: Array32, mask: Mask, target_mask: Mask, name: str
    ) -> tuple[Array32, Array32]:
        rows, columns = np.nonzero(mask & np.isfinite(source).all(axis=2))
        px, apart = _nearest_px(source[rows, columns], np.where(target_mask[..., None], target, np.nan))
        rng = stream(self.seed, name)
        px += rng.normal(scale=self.noise_px, size=px.shape)
        wrong = rng.uniform(size=len(px)) < self.outlier_share
        px[wrong] = rng.uniform(size=(int(wrong.sum()), 2)) * [target.shape[1], target.shape[0]]
        good = apart <= self.tolerance
        # Without a true match the flow leads out of the image.
        flow, confidence = np.full((*mask.shape, 2), -1.0, np.float32), np.zeros(mask.shape, np.float32)
        flow[rows[good], columns[good]], confidence[rows[good], columns[good]] = px[good], 1.0
        return flow, confidence


def _undistorted(camera: Camera, image: Image, max_px: int) -> tuple[Camera, Image]:
    """The pinhole camera of a photo at the size of its depth map, and what it shows."""
    i = camera.intrinsics
    flat = cv2.undistort(image, i.matrix_cv(), np.array(i.distortion), None, i.matrix_cv())
    ratio = min(1.0, max_px / max(i.width, i.height))
    size = (round(i.width * ratio), round(i.height * ratio))
    small = replace(camera, intrinsics=i.undistorted().resized(*size))
    return small, cv2.resize(flat, size, interpolation=cv2.INTER_AREA)


def _nearest_px(points: Array32, raster: Array32) -> tuple[Array, Array]:
    """Pixels (n, 2) of a raster of positions (h, w, 3) nearest to points (n, 3), and the distances (n,) left.

    Between pixels the raster is taken as flat.
    """
    rows, columns = np.nonzero(np.isfinite(raster).all(axis=2))
    if not len(rows) or not len(points):
        return np.zeros((len(points), 2)), np.full(len(points), np.inf)
    _, index = cKDTree(raster[rows, columns]).query(points)
    row, column = rows[index], columns[index]
    gap = points - raster[row, column]
    sides = np.nan_to_num(np.stack([np.gradient(raster, axis=axis)[row, column] for axis in (1, 0)], axis=2))
    step = np.clip(np.einsum("nij,nj->ni", np.linalg.pinv(sides.astype(np.float64)), gap), -0.75, 0.75)
    left = np.linalg.norm(gap - np.einsum("nij,nj->ni", sides, step), axis=1)
    return np.column_stack([column, row]) + 0.5 + step, left


def _patches(rng: np.random.Generator, shape: tuple[int, ...], share: float) -> Mask:
    """About that share of a picture, in squares."""
    coarse = rng.uniform(size=[-(-side // PATCH_PX) for side in shape]) < share
    return np.asarray(np.kron(coarse, np.ones((PATCH_PX, PATCH_PX), bool))[: shape[0], : shape[1]])


def _digest(image: Image) -> str:
    return sha256(repr(image.shape).encode() + np.ascontiguousarray(image).tobytes()).hexdigest()
