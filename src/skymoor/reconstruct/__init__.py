# SPDX-License-Identifier: Apache-2.0
"""Structure from motion from pixels alone: photos to components."""

from skymoor.reconstruct._aliked import AlikedPairMatcher
from skymoor.reconstruct._colmap_aliked import ColmapAlikedMatcher
from skymoor.reconstruct._dedode import DedodeDetector
from skymoor.reconstruct._dedode_roma import DedodeRomaMatcher, DenseWarp, KeypointDetector
from skymoor.reconstruct._doppelgangers import DoppelgangerClassifier
from skymoor.reconstruct._sift import SiftMatcher
from skymoor.reconstruct.calibration import with_focal
from skymoor.reconstruct.doppelgangers import ConflictFilter
from skymoor.reconstruct.mapping import ReconstructOptions, ground_options, reconstruct
from skymoor.reconstruct.protocol import PairFilter, PairMatcher, ViewGraph
from skymoor.reconstruct.shared_intrinsics import IntrinsicsOptions

__all__ = [
    "AlikedPairMatcher",
    "ColmapAlikedMatcher",
    "ConflictFilter",
    "DedodeDetector",
    "DedodeRomaMatcher",
    "DenseWarp",
    "DoppelgangerClassifier",
    "IntrinsicsOptions",
    "KeypointDetector",
    "PairFilter",
    "PairMatcher",
    "ReconstructOptions",
    "SiftMatcher",
    "ViewGraph",
    "ground_options",
    "reconstruct",
    "with_focal",
]
