# SPDX-License-Identifier: Apache-2.0
"""Depth for every pixel of every photo."""

from skymoor.densify._depth_anything import DepthAnythingDepth, MetricDepthNetwork
from skymoor.densify._marigold import MarigoldDepth
from skymoor.densify._patchmatch import PatchMatchDepth, read_colmap_depth
from skymoor.densify._sgm import SgmDepth
from skymoor.densify.agreement import AgreementOptions, PhotoWitness, hear_photos
from skymoor.densify.engines import MetricDepthOptions, RelativeDepthOptions, StereoOptions
from skymoor.densify.metric_scale import MetricScale, scale_from_metric_depth
from skymoor.densify.protocol import DepthEstimator, MetricDepth, MonocularDepth
from skymoor.densify.views import blind_map

__all__ = [
    "AgreementOptions",
    "DepthAnythingDepth",
    "DepthEstimator",
    "MarigoldDepth",
    "MetricDepth",
    "MetricDepthNetwork",
    "MetricDepthOptions",
    "MetricScale",
    "MonocularDepth",
    "PatchMatchDepth",
    "PhotoWitness",
    "RelativeDepthOptions",
    "SgmDepth",
    "StereoOptions",
    "blind_map",
    "hear_photos",
    "read_colmap_depth",
    "scale_from_metric_depth",
]
