# SPDX-License-Identifier: Apache-2.0
"""The offline default: COLMAP's SIFT on the CPU, matched by brute force and verified."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from skymoor.engines.options import FIXED
from skymoor.reconstruct.database import enter_photos, extract, match, stored, threads
from skymoor.reconstruct.pairs import exhaustive_pairs, preemptive_pairs
from skymoor.reconstruct.protocol import PairMatcher, colmap_name
from skymoor.types import Array32, Photos, Progress

LARGE_PX = 1600  # longer side from which photos are not enlarged before features are found


@dataclass(frozen=True)
class SiftMatcher:
    """COLMAP SIFT (Lowe 2004; RootSIFT normalisation) with exhaustive or preemptive pairs.

    Attributes:
        max_features: per photo; 8192 are not better than 4096 on the sets that we measured.
        max_image_px: longer sides are reduced before detection (key points keep the full photo's pixels).
        shared_camera: photos of one size are taken by one camera.
        exhaustive_below: sets of at most this many photos match every pair.
        neighbours: partners per photo in larger sets.
        retrieval_features: of each photo's largest features, for choosing partners.
        block_pairs: matched between two reports of progress.
    """

    max_features: int = 4096
    max_image_px: int = 1600
    shared_camera: bool = field(default=True, metadata=FIXED)
    exhaustive_below: int = field(default=40, metadata=FIXED)
    neighbours: int = field(default=20, metadata=FIXED)
    retrieval_features: int = field(default=512, metadata=FIXED)
    block_pairs: int = field(default=64, metadata=FIXED)

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        """Fill `database`; see `PairMatcher`."""
        n = len(photos)
        total = 3 * n  # extraction, choice of partners and matching take about as long
        enter_photos(photos, database, shared_camera=self.shared_camera)
        options = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=threads())
        options.max_image_size = self.max_image_px
        options.sift.max_num_features = self.max_features
        # Twice the size finds blobs of two pixels, which large photos have no need of: the same poses in half the time.
        options.sift.first_octave = 0 if min(max(size) for size in photos.sizes) >= LARGE_PX else -1
        extract(
            photos,
            database,
            folder,
            options,
            grey=True,
            shared_camera=self.shared_camera,
            report=lambda done: progress(done, total),
        )
        pairs = self._pairs(photos, database)
        match(
            photos,
            database,
            folder,
            pairs,
            pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=threads()),
            block_pairs=self.block_pairs,
            seed=seed,
            report=lambda done: progress(n + 2 * n * done // len(pairs), total),
        )

    def _pairs(self, photos: Photos, database: Path) -> list[tuple[int, int]]:
        if len(photos) <= self.exhaustive_below:
            return exhaustive_pairs(len(photos))
        with pycolmap.Database.open(database) as db:
            descriptors = [
                _largest(db, colmap_name(i, size), self.retrieval_features) for i, size in enumerate(photos.sizes)
            ]
        return preemptive_pairs(descriptors, neighbours=self.neighbours)


_: type[PairMatcher] = SiftMatcher


def _largest(db: pycolmap.Database, name: str, count: int) -> Array32:
    """Unit descriptors (at most `count`, 128) of an image's largest features."""
    image_id = stored(db, name).image_id
    affine = db.read_keypoints(image_id)[:, 2:6]
    scale = np.abs(affine[:, 0] * affine[:, 3] - affine[:, 1] * affine[:, 2])
    data = db.read_descriptors(image_id).data[np.argsort(-scale)[:count]].astype(np.float32)
    return np.asarray(data / np.maximum(np.linalg.norm(data, axis=1, keepdims=True), 1e-9))
