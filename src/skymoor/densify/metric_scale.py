# SPDX-License-Identifier: Apache-2.0
"""Metric scale of a model by monocular metric depth (paper, section 5, tile size)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skymoor.densify.protocol import MetricDepth
from skymoor.errors import TooFewMatches
from skymoor.types import Array, Array32, DepthMap, Progress, no_progress

MAD = 1.4826  # standard deviation over median absolute deviation, of a normal distribution
MEDIAN = 1.2533  # standard error of a median over that of a mean


@dataclass(frozen=True, eq=False)
class MetricScale:
    """Metres per unit of the depth maps, its relative standard deviation, and the ratio of each photo that had one."""

    metres_per_unit: float
    sigma_ratio: float
    per_photo: Array

    def narrowed(self, low: float, high: float, *, sigmas: float = 2.5) -> tuple[float, float]:
        """The intersection of a range of metres per unit with this scale's interval; the whole range if it is empty."""
        factor = float(np.exp(sigmas * self.sigma_ratio))
        interval = self.metres_per_unit / factor, self.metres_per_unit * factor
        inner = max(low, interval[0]), min(high, interval[1])
        return inner if inner[0] < inner[1] else (low, high)


def scale_from_metric_depth(
    maps: Sequence[DepthMap],
    metres: Sequence[Array32],
    *,
    max_sigma_ratio: float = 0.05,
    min_pixels: int = 200,
    min_photos: int = 3,
    common_sigma_ratio: float = 0.15,
) -> MetricScale:
    """The scale that makes depth maps agree with metric depths of the same images.

    It is the median over the photos of the median ratio over their pixels: a network may be wrong in parts of a photo,
    and in whole photos.

    Args:
        maps: measured depths, in one common unit.
        metres: metric depth (h, w) of each map's image by a `MetricDepth`, NaN where unknown.
        max_sigma_ratio: less certain depths are left out.
        min_pixels: photos with fewer common pixels are left out.
        min_photos: fewer photos give no scale.
        common_sigma_ratio: relative standard deviation of a common error of the network, not visible in the spread.

    Raises:
        TooFewMatches: too few photos have depths of both kinds.
    """
    logs = []
    for depth_map, metric in zip(maps, metres, strict=True):
        with np.errstate(invalid="ignore"):
            good = (depth_map.sigma < max_sigma_ratio * depth_map.depth) & (depth_map.depth > 0) & (metric > 0)
        if np.count_nonzero(good) >= min_pixels:
            logs.append(float(np.median(np.log(metric[good].astype(np.float64) / depth_map.depth[good]))))
    if len(logs) < min_photos:
        raise TooFewMatches(
            f"{len(logs)} of {len(maps)} photos have both metric and measured depths; {min_photos} are required"
        )
    per_photo = np.array(logs)
    middle = float(np.median(per_photo))
    spread = MAD * float(np.median(np.abs(per_photo - middle)))
    sigma = float(np.hypot(MEDIAN * spread / np.sqrt(len(logs)), common_sigma_ratio))
    return MetricScale(float(np.exp(middle)), sigma, np.exp(per_photo))


def metric_scale_of_photos(
    maps: Sequence[DepthMap], engine: MetricDepth, *, progress: Progress = no_progress
) -> MetricScale | None:
    """Metres per unit of a component, by a network's depths of its photos; None where they are not sufficient."""
    metres = []
    for depth_map in maps:
        metres.append(engine(depth_map.rgb, depth_map.camera.intrinsics.fx))
        progress(len(metres), len(maps))
    try:
        return scale_from_metric_depth(maps, metres)
    except TooFewMatches:
        return None
