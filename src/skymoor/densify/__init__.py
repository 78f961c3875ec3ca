# SPDX-License-Identifier: Apache-2.0
"""Depth maps of photos: stereo, monocular depth, and pose checks with them."""

from skymoor.densify._depth_anything import DepthAnythingDepth, MetricDepthNetwork
from skymoor.densify._marigold import MarigoldDepth
from skymoor.densify._patchmatch import PatchMatchDepth, read_colmap_depth
from skymoor.densify._sgm import SgmDepth
from skymoor.densify.metric_scale import MetricScale, metric_scale_of_photos, scale_from_metric_depth
from skymoor.densify.pose_checks import AgreementOptions, PoseCheck, check_camera_poses, check_poses
from skymoor.densify.protocol import DepthEstimator, MetricDepth, MonocularDepth
from skymoor.densify.single_photos import relative_depths
from skymoor.densify.views import empty_depth_map

__all__ = [
    "AgreementOptions",
    "DepthAnythingDepth",
    "DepthEstimator",
    "MarigoldDepth",
    "MetricDepth",
    "MetricDepthNetwork",
    "MetricScale",
    "MonocularDepth",
    "PatchMatchDepth",
    "PoseCheck",
    "SgmDepth",
    "check_camera_poses",
    "check_poses",
    "empty_depth_map",
    "metric_scale_of_photos",
    "read_colmap_depth",
    "relative_depths",
    "scale_from_metric_depth",
]
