# SPDX-License-Identifier: Apache-2.0
"""The choices of dense stereo and of depth from single photos."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from skymoor.densify._depth_anything import DepthAnythingDepth, MetricDepthNetwork
from skymoor.densify._marigold import MarigoldDepth
from skymoor.densify._patchmatch import PatchMatchDepth
from skymoor.densify._sgm import SgmDepth
from skymoor.densify.protocol import DepthEstimator, MetricDepth, MonocularDepth
from skymoor.engines.choice import Choice
from skymoor.types import Array32, Component, DepthMap, Image, Photos, Progress, no_progress


@dataclass(frozen=True)
class StereoOptions(Choice):
    """Which dense stereo measures depth.

    Attributes:
        kind: "sgm" runs on a CPU; "patchmatch", the paper's, needs a COLMAP with CUDA.
        sgm, patchmatch: how each is set up.
    """

    kind: Literal["sgm", "patchmatch"] = "sgm"
    sgm: SgmDepth = field(default_factory=SgmDepth)
    patchmatch: PatchMatchDepth = field(default_factory=PatchMatchDepth)

    @property
    def max_px(self) -> int:
        """Long side of the depth maps."""
        return int(self.engine.max_px)

    def __call__(self, component: Component, photos: Photos, *, progress: Progress = no_progress) -> list[DepthMap]:
        """Depth maps by the chosen one; see `DepthEstimator`."""
        maps: list[DepthMap] = self.engine(component, photos, progress=progress)
        return maps


@dataclass(frozen=True)
class RelativeDepthOptions(Choice):
    """Whose depths of single photos rank those of the radiance field, where photos measure none.

    Attributes:
        kind: "none", "marigold" (the paper's) or "depth_anything" (lighter).
        marigold, depth_anything: how each is set up.
    """

    kind: Literal["none", "marigold", "depth_anything"] = "none"
    marigold: MarigoldDepth = field(default_factory=MarigoldDepth)
    depth_anything: DepthAnythingDepth = field(default_factory=DepthAnythingDepth)

    def __call__(self, image: Image) -> Array32:
        """Depth by the chosen one; see `MonocularDepth`."""
        depth: Array32 = self.engine(image)
        return depth


@dataclass(frozen=True)
class MetricDepthOptions(Choice):
    """Whose metres of single photos say how large a ground component is.

    Attributes:
        kind: "none", or "network" for Depth Anything's metric models or ZoeDepth.
        network: how it is set up.
    """

    kind: Literal["none", "network"] = "none"
    network: MetricDepthNetwork = field(default_factory=MetricDepthNetwork)

    def __call__(self, image: Image, focal_px: float) -> Array32:
        """Depth by the chosen one; see `MetricDepth`."""
        metres: Array32 = self.engine(image, focal_px)
        return metres


_: type[DepthEstimator] = StereoOptions
_relative: type[MonocularDepth] = RelativeDepthOptions
_metric: type[MetricDepth] = MetricDepthOptions
