# SPDX-License-Identifier: Apache-2.0
"""Monocular depth of photos, for surfaces that stereo cannot measure."""

from __future__ import annotations

from collections.abc import Sequence

from skymoor.densify.protocol import MonocularDepth
from skymoor.types import Array32, DepthMap, Progress, no_progress


def relative_depths(
    maps: Sequence[DepthMap], engine: MonocularDepth, *, progress: Progress = no_progress
) -> list[Array32]:
    """Relative depths (h, w) of the photos of depth maps, in their order; larger is farther."""
    relative = []
    for depth_map in maps:
        relative.append(engine(depth_map.rgb))
        progress(len(relative), len(maps))
    return relative
