# SPDX-License-Identifier: Apache-2.0
"""Interfaces of dense stereo and monocular depth engines."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from skymoor.types import Array32, Component, DepthMap, Image, Photos, Progress


class DepthEstimator(Protocol):
    """Depth maps of a component's photos, in the component's frame and unit."""

    @property
    def max_px(self) -> int:
        """Largest long side of the depth maps, in pixels."""

    def __call__(self, component: Component, photos: Photos, *, progress: Progress) -> Iterator[DepthMap]:
        """One depth map per camera that has stereo partners, one after the other: all would fill the memory."""


class MonocularDepth(Protocol):
    """Relative depth of a single photo."""

    def __call__(self, image: Image) -> Array32:
        """Relative depth (h, w) of an image (h, w, 3): larger is farther; scale and zero are unknown."""


class MetricDepth(Protocol):
    """Metric depth of a single photo."""

    def __call__(self, image: Image, focal_px: float) -> Array32:
        """z-depth (h, w) in metres of an image (h, w, 3) without distortion, NaN where unknown."""
