# SPDX-License-Identifier: Apache-2.0
"""What a dense stereo engine is asked."""

from __future__ import annotations

from typing import Protocol

from skymoor.types import Component, DepthMap, Photos, Progress


class DepthEstimator(Protocol):
    """Depth maps of a component's photos, in the component's frame and unit."""

    def __call__(self, component: Component, photos: Photos, *, progress: Progress) -> list[DepthMap]:
        """One depth map per camera that has partners to measure with."""
