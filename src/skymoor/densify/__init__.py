# SPDX-License-Identifier: Apache-2.0
"""Depth for every pixel of every photo."""

from skymoor.densify._sgm import SgmDepth
from skymoor.densify.protocol import DepthEstimator, MonocularDepth
from skymoor.densify.views import blind_map

__all__ = ["DepthEstimator", "MonocularDepth", "SgmDepth", "blind_map"]
