# SPDX-License-Identifier: Apache-2.0
"""Depth maps and photos to a radiance field that can be rendered. `model.NerfModel` is what the builder returns."""

import os

# GNU OpenMP waits for work in a busy loop, which on a shared machine makes everybody many times slower. It reads this
# when PyTorch is loaded, so it is set before anything here can load it.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from skymoor.model.nerf.builder import NerfBuilder
from skymoor.model.nerf.options import HUGE, LossWeights, PriorOptions, Sizes, UncertaintyOptions

__all__ = ["HUGE", "LossWeights", "NerfBuilder", "PriorOptions", "Sizes", "UncertaintyOptions"]
