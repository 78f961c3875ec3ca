# SPDX-License-Identifier: Apache-2.0
"""Photos to components: structure from motion from nothing but pixels."""

from skymoor.reconstruct._sift import SiftMatcher
from skymoor.reconstruct.calibration import with_focal
from skymoor.reconstruct.mapping import ReconstructOptions, reconstruct
from skymoor.reconstruct.protocol import PairMatcher

__all__ = ["PairMatcher", "ReconstructOptions", "SiftMatcher", "reconstruct", "with_focal"]
