# SPDX-License-Identifier: Apache-2.0
"""The paper's matches of photos: key points of one engine, joined by the dense warp of another.

Section 3.1, structure from motion: DeDoDe detects, RoMa (Edstedt et al., CVPR 2024) says where each key point is in the
other photo, and the key point there is its match.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from skymoor.reconstruct._dedode import DedodeDetector
from skymoor.reconstruct._sift import SiftMatcher
from skymoor.reconstruct.pairs import exhaustive_pairs, preemptive_pairs
from skymoor.reconstruct.protocol import PairMatcher, colmap_name
from skymoor.types import Array, Array32, Image, Photos, Progress, Raster, Warp

RETRIEVAL_PX = 800


class KeypointDetector(Protocol):
    """Finds places in a photo that are found in others as well."""

    def __call__(self, image: Image) -> Array:
        """Key points (n, 2) of a photo (h, w, 3), in its pixels."""


class DenseWarp(Protocol):
    """What is asked of a dense matcher: those of the matching stage, such as RoMa, can do it."""

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """For each pixel of one picture its place in the other, both ways."""


@dataclass(frozen=True)
class DedodeRomaMatcher:
    """Key points that a dense warp takes to each other. A GPU is wanted: RoMa looks at every pair.

    Attributes:
        dense: the warp; stages do not know each other's engines, so it is given.
        detector: the key points.
        side_px: photos are reduced to this long side for the warp.
        max_distance_px: of the photo so reduced, between where the warp leads and the key point that is there.
        min_confidence: of the warp, at both ends.
        shared_camera: photos of one size are taken by one camera.
        exhaustive_below: sets of at most this many photos match every pair.
        neighbours: partners per photo in larger sets, chosen by their largest SIFT features.
        min_matches: pairs with fewer are not worth verifying.
    """

    dense: DenseWarp
    detector: KeypointDetector = field(default_factory=DedodeDetector)
    side_px: int = 1120
    max_distance_px: float = 2.0
    min_confidence: float = 0.2
    shared_camera: bool = True
    exhaustive_below: int = 40
    neighbours: int = 20
    min_matches: int = 15

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        """Fill `database`; see `PairMatcher`. Raises what the two engines raise."""
        SiftMatcher(shared_camera=self.shared_camera)._enter(photos, database)
        names = [colmap_name(k, size) for k, size in enumerate(photos.sizes)]
        n = len(photos)
        keypoints = []
        for k, name in enumerate(photos.names):
            keypoints.append(self.detector(photos.read(name)))
            progress(k + 1, 3 * n)
        pairs = self._pairs(photos)
        verified = []
        with pycolmap.Database.open(database) as db:
            ids = [_image_id(db, name) for name in names]
            for image_id, px in zip(ids, keypoints, strict=True):
                db.write_keypoints(image_id, px.astype(np.float32))
            for done, (i, j, index) in enumerate(self._matched(photos, keypoints, pairs)):
                if len(index) >= self.min_matches:
                    db.write_matches(ids[i], ids[j], index)
                    verified.append(f"{names[i]} {names[j]}\n")
                progress(n + 2 * n * (done + 1) // (len(pairs) + 1), 3 * n)
        (folder / "pairs.txt").write_text("".join(verified))
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = seed
        # The key points are as good as the pixels that they were found in.
        verification.ransac.max_error = max(verification.ransac.max_error, 2 * self._coarsest(photos))
        if verified:
            pycolmap.verify_matches(database, folder / "pairs.txt", verification)
        progress(3 * n, 3 * n)

    def _pairs(self, photos: Photos) -> list[tuple[int, int]]:
        if len(photos) <= self.exhaustive_below:
            return exhaustive_pairs(len(photos))
        return preemptive_pairs([_largest(photos.read(name)) for name in photos.names], neighbours=self.neighbours)

    def _matched(
        self, photos: Photos, keypoints: Sequence[Array], pairs: Sequence[tuple[int, int]]
    ) -> Iterator[tuple[int, int, NDArray[np.uint32]]]:
        @lru_cache(maxsize=16)
        def small(index: int) -> Raster:
            return _reduced(photos.read(photos.names[index]), self.side_px)

        for i, j in pairs:
            a, b = small(i), small(j)
            px_a, px_b = (
                keypoints[k] * (np.array(raster.mask.shape[::-1]) / photos.sizes[k]) for k, raster in ((i, a), (j, b))
            )
            yield (
                i,
                j,
                match_keypoints(
                    self.dense(a, b),
                    px_a,
                    px_b,
                    max_distance_px=self.max_distance_px,
                    min_confidence=self.min_confidence,
                ),
            )

    def _coarsest(self, photos: Photos) -> float:
        """How many pixels of the largest photo one of the warp is."""
        return max(1.0, max((max(size) for size in photos.sizes), default=0) / self.side_px)


def match_keypoints(
    warp: Warp, px_a: Array, px_b: Array, *, max_distance_px: float, min_confidence: float
) -> NDArray[np.uint32]:
    """Rows (m, 2) of key points (n, 2) that the warp takes to each other, both ways.

    Of each picture's key points the one nearest to where the flow leads counts, if it is near enough and the flow is
    confident there; and it must lead back to the key point that it comes from.
    """
    b_of_a = _led_to(warp.b_from_a, warp.confidence_a, px_a, px_b, max_distance_px, min_confidence)
    a_of_b = _led_to(warp.a_from_b, warp.confidence_b, px_b, px_a, max_distance_px, min_confidence)
    rows = np.flatnonzero(b_of_a >= 0)
    rows = rows[a_of_b[b_of_a[rows]] == rows]
    return np.column_stack([rows, b_of_a[rows]]).astype(np.uint32)


_: type[PairMatcher] = DedodeRomaMatcher


def _led_to(
    flow: Array32, confidence: Array32, source: Array, target: Array, max_distance_px: float, min_confidence: float
) -> NDArray[np.intp]:
    """For each source point (n, 2) the row of the target point that the flow leads to, -1 where none."""
    if not len(source) or not len(target):
        return np.full(len(source), -1, np.intp)
    h, w = confidence.shape
    inside = ((source >= 0) & (source < [w, h])).all(axis=1)
    at = np.stack([source[:, 1], source[:, 0]]) - 0.5
    there = np.stack([map_coordinates(flow[..., k], at, order=1, mode="nearest") for k in (0, 1)], axis=1)
    sure = map_coordinates(confidence, at, order=0, mode="nearest") >= min_confidence
    good = inside & sure & np.isfinite(there).all(axis=1)
    apart, index = cKDTree(target).query(np.where(good[:, None], there, 0.0))
    return np.where(good & (apart <= max_distance_px), index, -1)


def _image_id(db: pycolmap.Database, name: str) -> int:
    image = db.read_image_with_name(name)
    if image is None:
        raise LookupError(f"{name} is not in the database")
    return int(image.image_id)


def _reduced(image: Image, side_px: int) -> Raster:
    h, w = image.shape[:2]
    ratio = min(1.0, side_px / max(h, w))
    size = (max(1, round(w * ratio)), max(1, round(h * ratio)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if ratio < 1 else image
    return Raster(np.asarray(small, np.uint8), np.ones(size[::-1], bool))


def _largest(image: Image, count: int = 512) -> Array32:
    """Unit descriptors (at most `count`, 128) of a photo's largest SIFT features."""
    grey = cv2.cvtColor(_reduced(image, RETRIEVAL_PX).rgb, cv2.COLOR_RGB2GRAY)
    points, descriptors = cv2.SIFT.create(nfeatures=4 * count).detectAndCompute(grey, None)
    if descriptors is None or not len(points):
        return np.zeros((0, 128), np.float32)
    largest = np.argsort([-point.size for point in points], kind="stable")[:count]
    root = np.sqrt(descriptors[largest] / np.maximum(descriptors[largest].sum(axis=1, keepdims=True), 1e-9))
    return np.asarray(root, np.float32)
