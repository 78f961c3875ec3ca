# SPDX-License-Identifier: Apache-2.0
"""Radiance field, trained from photos and depth maps. `model.NerfModel` is what the builder returns."""

from skymoor.model.nerf.builder import NerfBuilder
from skymoor.model.nerf.options import HUGE, LossWeights, PriorOptions, Sizes, UncertaintyOptions

__all__ = ["HUGE", "LossWeights", "NerfBuilder", "PriorOptions", "Sizes", "UncertaintyOptions"]
