# SPDX-License-Identifier: Apache-2.0
"""What a dense stereo engine is asked, and one that looks at a single photo."""

from __future__ import annotations

from typing import Protocol

from skymoor.types import Array32, Component, DepthMap, Image, Photos, Progress


class DepthEstimator(Protocol):
    """Depth maps of a component's photos, in the component's frame and unit."""

    @property
    def max_px(self) -> int:
        """Long side of the depth maps, at most."""

    def __call__(self, component: Component, photos: Photos, *, progress: Progress) -> list[DepthMap]:
        """One depth map per camera that has partners to measure with."""


class MonocularDepth(Protocol):
    """Depth from a single photo, as far as one can tell."""

    def __call__(self, image: Image) -> Array32:
        """Relative depth (h, w) of an image (h, w, 3): larger is farther; scale and zero are unknown."""


class MetricDepth(Protocol):
    """Depth in metres from a single photo, as far as one can tell."""

    def __call__(self, image: Image, focal_px: float) -> Array32:
        """z-depth (h, w) in metres of an image (h, w, 3) without distortion, NaN where nothing is said."""
