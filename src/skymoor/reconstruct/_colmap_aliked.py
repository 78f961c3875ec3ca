# SPDX-License-Identifier: Apache-2.0
"""COLMAP's own learned features, for builds of pycolmap that can read their models (ONNX)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pycolmap

from skymoor.engines.options import FIXED
from skymoor.engines.weights import find
from skymoor.errors import BackendUnavailable
from skymoor.reconstruct.database import enter_photos, extract, likely_pairs, match, threads
from skymoor.reconstruct.protocol import PairMatcher
from skymoor.types import Photos, Progress

NAME = "colmap-aliked"
JOINED_BY = {"nearest": "bruteforce-matcher.onnx", "lightglue": "aliked-lightglue.onnx"}


@dataclass(frozen=True)
class ColmapAlikedMatcher:
    """ALIKED n16rot in COLMAP, matched by nearest neighbours or by LightGlue.

    Attributes:
        models: folder of the three models; empty for where `skymoor weights fetch colmap-aliked` puts them. COLMAP
            itself would download them at the first use.
        join: "nearest" or "lightglue".
        max_features: per photo.
        max_image_px: longer sides are reduced before detection.
        shared_camera, exhaustive_below, neighbours, block_pairs: see `SiftMatcher`.
    """

    models: str = ""
    join: Literal["nearest", "lightglue"] = "lightglue"
    max_features: int = 4096
    max_image_px: int = 1600
    shared_camera: bool = field(default=True, metadata=FIXED)
    exhaustive_below: int = field(default=40, metadata=FIXED)
    neighbours: int = field(default=20, metadata=FIXED)
    block_pairs: int = field(default=64, metadata=FIXED)

    def ready(self) -> tuple[Path, ...]:
        """The files that will be read.

        Raises:
            BackendUnavailable: this build of COLMAP has no ONNX, or the models are missing.
            InputError: they are not in the given folder.
        """
        # Without ONNX, extraction would end the whole process from one of its threads.
        if not hasattr(pycolmap.FeatureExtractionOptions(), "aliked"):
            raise BackendUnavailable(
                "COLMAP's learned features: this build of pycolmap has no ONNX (those on PyPI have not); "
                "build it with ONNX, or use reconstruct.matcher = aliked, the same network in PyTorch"
            )
        names = ("aliked-n16rot.onnx", JOINED_BY[self.join])
        return tuple(find(NAME, name, Path(self.models) / name if self.models else "") for name in names)

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        """Fill `database`; see `PairMatcher`. Raises what `ready` raises."""
        features, joint = self.ready()
        n = len(photos)
        enter_photos(photos, database, shared_camera=self.shared_camera)
        extraction, matching = self._options(features, joint)
        extract(
            photos,
            database,
            folder,
            extraction,
            grey=False,
            shared_camera=self.shared_camera,
            report=lambda done: progress(done, 3 * n),
        )
        pairs = likely_pairs(photos, exhaustive_below=self.exhaustive_below, neighbours=self.neighbours)
        match(
            photos,
            database,
            folder,
            pairs,
            matching,
            block_pairs=self.block_pairs,
            seed=seed,
            report=lambda done: progress(n + 2 * n * done // len(pairs), 3 * n),
        )

    def _options(self, features: Path, joint: Path) -> tuple[Any, Any]:
        """COLMAP's options; typed Any, because builds without ONNX lack some of the names."""
        use = {"use_gpu": pycolmap.has_cuda, "num_threads": threads()}
        extraction: Any = pycolmap.FeatureExtractionOptions(**use)
        extraction.type = pycolmap.FeatureExtractorType.ALIKED_N16ROT
        extraction.max_image_size = self.max_image_px
        extraction.aliked.max_num_features = self.max_features
        extraction.aliked.n16rot_model_path = str(features)
        matching: Any = pycolmap.FeatureMatchingOptions(**use)
        if self.join == "lightglue":
            matching.type = pycolmap.FeatureMatcherType.ALIKED_LIGHTGLUE
            matching.aliked.lightglue_model_path = str(joint)
        else:
            matching.type = pycolmap.FeatureMatcherType.ALIKED_BRUTEFORCE
            matching.aliked.bruteforce_model_path = str(joint)
        return extraction, matching


_: type[PairMatcher] = ColmapAlikedMatcher
