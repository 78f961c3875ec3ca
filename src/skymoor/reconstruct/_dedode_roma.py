# SPDX-License-Identifier: Apache-2.0
"""The paper's matches of photos: key points of a detector, matched by a dense warp.

Section 3.1, structure from motion: DeDoDe detects, RoMa (Edstedt et al., CVPR 2024) predicts each key point in the
other photo, and the nearest key point there is its match.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from skymoor.engines.batches import match_many
from skymoor.engines.options import FIXED, files_of
from skymoor.engines.tensors import fitted
from skymoor.reconstruct._dedode import DedodeDetector
from skymoor.reconstruct.database import Matched, coarsest_px, enter_photos, likely_pairs, write_verified
from skymoor.reconstruct.protocol import PairMatcher
from skymoor.types import Array, Array32, Image, Photos, Progress, Raster, Warp


class KeypointDetector(Protocol):
    """Detects repeatable key points in a photo."""

    def __call__(self, image: Image) -> Array:
        """Key points (n, 2) of a photo (h, w, 3), in its pixels."""


class DenseWarp(Protocol):
    """Interface of a dense matcher; those of the matching stage, such as RoMa, have it."""

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """For each pixel of one image its position in the other, in both directions."""


@dataclass(frozen=True)
class DedodeRomaMatcher:
    """Key points matched by a dense warp. A GPU is recommended: RoMa processes every pair.

    Attributes:
        dense: the dense matcher.
        detector: of the key points.
        side_px: photos are reduced to this long side for the warp.
        max_distance_px: in the reduced photo, between the warped key point and its match.
        min_confidence: of the warp, at both ends.
        shared_camera: photos of one size are taken by one camera.
        exhaustive_below: sets of at most this many photos match every pair.
        neighbours: partners per photo in larger sets, chosen by their largest SIFT features.
        min_matches: pairs with fewer are not verified.
    """

    dense: DenseWarp
    detector: KeypointDetector = field(default_factory=DedodeDetector)
    side_px: int = 1120
    max_distance_px: float = field(default=2.0, metadata=FIXED)
    min_confidence: float = field(default=0.2, metadata=FIXED)
    shared_camera: bool = field(default=True, metadata=FIXED)
    exhaustive_below: int = field(default=40, metadata=FIXED)
    neighbours: int = field(default=20, metadata=FIXED)
    min_matches: int = field(default=15, metadata=FIXED)

    def ready(self) -> tuple[Path, ...]:
        """The files that both engines will read. Raises as they do."""
        return files_of(self.dense, self.detector)

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        """Fill `database`; see `PairMatcher`. Raises as the two engines do."""
        n = len(photos)
        enter_photos(photos, database, shared_camera=self.shared_camera)
        keypoints = []
        for k, name in enumerate(photos.names):
            keypoints.append(self.detector(photos.read(name)))
            progress(k + 1, 3 * n)
        pairs = likely_pairs(photos, exhaustive_below=self.exhaustive_below, neighbours=self.neighbours)
        write_verified(
            photos,
            database,
            folder,
            keypoints,
            self._matched(photos, keypoints, pairs, lambda done: progress(n + 2 * n * done // len(pairs), 3 * n)),
            min_matches=self.min_matches,
            pixel_px=coarsest_px(photos, self.side_px),
            seed=seed,
        )
        progress(3 * n, 3 * n)

    def _matched(
        self,
        photos: Photos,
        keypoints: Sequence[Array],
        pairs: Sequence[tuple[int, int]],
        report: Callable[[int], None],
    ) -> Iterator[Matched]:
        @lru_cache(maxsize=16)
        def small(index: int) -> Raster:
            image, _ = fitted(photos.read(photos.names[index]), self.side_px, 1)
            return Raster(image, np.ones(image.shape[:2], bool))

        warps = match_many(self.dense, ((small(i), small(j)) for i, j in pairs))
        for done, ((i, j), warp) in enumerate(zip(pairs, warps, strict=True)):
            a, b = small(i), small(j)
            px_a, px_b = (
                keypoints[k] * (np.array(raster.mask.shape[::-1]) / photos.sizes[k]) for k, raster in ((i, a), (j, b))
            )
            limits = {"max_distance_px": self.max_distance_px, "min_confidence": self.min_confidence}
            yield i, j, match_keypoints(warp, px_a, px_b, **limits)
            report(done + 1)


def match_keypoints(
    warp: Warp, px_a: Array, px_b: Array, *, max_distance_px: float, min_confidence: float
) -> NDArray[np.uint32]:
    """Rows (m, 2) of key points (n, 2) that the warp maps to each other, in both directions.

    The match is the key point nearest to the warped one, if it is near enough and the warp is confident there; matches
    must be mutual.
    """
    b_of_a = _nearest_target(warp.b_from_a, warp.confidence_a, px_a, px_b, max_distance_px, min_confidence)
    a_of_b = _nearest_target(warp.a_from_b, warp.confidence_b, px_b, px_a, max_distance_px, min_confidence)
    rows = np.flatnonzero(b_of_a >= 0)
    rows = rows[a_of_b[b_of_a[rows]] == rows]
    return np.column_stack([rows, b_of_a[rows]]).astype(np.uint32)


_: type[PairMatcher] = DedodeRomaMatcher


def _nearest_target(
    flow: Array32, confidence: Array32, source: Array, target: Array, max_distance_px: float, min_confidence: float
) -> NDArray[np.intp]:
    """For each source point (n, 2) the row of the target point at its warped position, -1 where there is none."""
    if not len(source) or not len(target):
        return np.full(len(source), -1, np.intp)
    h, w = confidence.shape
    inside = ((source >= 0) & (source < [w, h])).all(axis=1)
    at = np.stack([source[:, 1], source[:, 0]]) - 0.5
    warped = np.stack([map_coordinates(flow[..., k], at, order=1, mode="nearest") for k in (0, 1)], axis=1)
    confident = map_coordinates(confidence, at, order=0, mode="nearest") >= min_confidence
    good = inside & confident & np.isfinite(warped).all(axis=1)
    apart, index = cKDTree(target).query(np.where(good[:, None], warped, 0.0))
    return np.where(good & (apart <= max_distance_px), index, -1)
