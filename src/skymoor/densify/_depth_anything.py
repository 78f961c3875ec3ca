# SPDX-License-Identifier: Apache-2.0
"""Monocular depth in one pass, through the library transformers: relative and metric.

Yang et al., Depth Anything V2, NeurIPS 2024. Metric also ZoeDepth (Bhat et al. 2023). The paper proposes
Metric3D (Yin et al., ICCV 2023) for the tile scale, whose weights need a licence and whose code is not packaged; its
correction by the focal length is applied here to the others.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skymoor.densify.protocol import MetricDepth, MonocularDepth
from skymoor.engines.libraries import require, torch_device
from skymoor.engines.options import FIXED
from skymoor.engines.weights import find
from skymoor.engines.weights.repository import describes, open_model, reading
from skymoor.errors import InputError
from skymoor.types import Array32, Image


@dataclass(frozen=True)
class DepthAnythingDepth:
    """Depth Anything, relative.

    Attributes:
        weights: folder of the model; empty for where `skymoor weights fetch depth-anything-small` puts it.
        device: "auto", "cpu" or "cuda".
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)

    def ready(self) -> tuple[Path, ...]:
        """The folder that will be read; see `__call__` for what is raised where something is missing."""
        require("transformers", "depth")
        return (find("depth-anything-small", "model", self.weights),)

    def __call__(self, image: Image) -> Array32:
        """Depth (h, w) from -1, nearest, to 0, farthest; see `MonocularDepth`.

        The network predicts inverse depth up to scale and offset, which cannot be converted to depth. It is negated
        instead: the order is that of depth; distances are not proportional.

        Raises:
            BackendUnavailable: transformers or the weights are missing.
            InputError: the folder has no Depth Anything, a metric one, or not all of it.
        """
        device = torch_device(self.device)
        (folder,) = self.ready()
        inverse, _ = _predict(folder, device, image, metric=False)
        low, high = float(inverse.min()), float(inverse.max())
        return np.asarray((low - inverse) / max(high - low, 1e-12), np.float32)


@dataclass(frozen=True)
class MetricDepthNetwork:
    """Depth in metres, of Depth Anything's metric models or ZoeDepth.

    A network trained with one camera relates the size in the image to distance, whatever the focal length. Its
    prediction is therefore multiplied by the ratio of the focal lengths.

    Attributes:
        weights: folder of the model; empty for where `skymoor weights fetch metric-depth-small` puts it.
        device: "auto", "cpu" or "cuda".
        canonical_focal_px: focal length of the images that the network was trained with, in pixels of its input; 0 for
            no correction. 1000 is that of Virtual KITTI at 518 rows, for Depth Anything outdoors.
        max_m: larger depths are dropped: outdoor networks are trained up to 80 m.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    canonical_focal_px: float = 1000.0
    max_m: float = 75.0

    def ready(self) -> tuple[Path, ...]:
        """The folder that will be read; see `__call__` for what is raised where something is missing."""
        require("transformers", "depth")
        return (find("metric-depth-small", "model", self.weights),)

    def __call__(self, image: Image, focal_px: float) -> Array32:
        """z-depth (h, w) in metres; see `MetricDepth`.

        Raises:
            BackendUnavailable: transformers or the weights are missing.
            InputError: the folder has no such network, a relative one, or not all of it.
        """
        device = torch_device(self.device)
        (folder,) = self.ready()
        depth, ratio = _predict(folder, device, image, metric=True)
        known = np.where((depth > 0) & (depth < self.max_m), depth, np.nan)
        focal_ratio = focal_px * ratio / self.canonical_focal_px if self.canonical_focal_px > 0 else 1.0
        return np.asarray(known * focal_ratio, np.float32)


_: type[MonocularDepth] = DepthAnythingDepth
_metric: type[MetricDepth] = MetricDepthNetwork


def _predict(folder: Path, device: str, image: Image, *, metric: bool) -> tuple[Array32, float]:
    """Prediction of the network (h, w), and rows of its input per row of the photo."""
    processor, network = _network(folder, device, metric=metric)
    import torch
    from PIL import Image as PilImage

    # ZoeDepth's processor would pad the photo, and needs torchvision to crop the result.
    inputs = processor(images=PilImage.fromarray(image), do_pad=False, return_tensors="pt").to(device)
    with torch.inference_mode():
        predicted = network(**inputs).predicted_depth
    # The library's own resampling is cubic, and overshoots at edges to depths below 0.
    h, w = image.shape[:2]
    depth = cv2.resize(predicted[0].float().cpu().numpy(), (w, h), interpolation=cv2.INTER_LINEAR)
    return np.asarray(depth, np.float32), inputs["pixel_values"].shape[-2] / h


@lru_cache(maxsize=2)
def _network(folder: Path, device: str, *, metric: bool) -> tuple[Any, Any]:
    transformers = require("transformers", "depth")
    kinds = ("depth_anything", "zoedepth") if metric else ("depth_anything",)
    network = open_model(transformers.AutoModelForDepthEstimation, folder, kinds)
    kind = describes(folder).get("depth_estimation_type", "metric" if "zoedepth" in kinds else "relative")
    if kind != ("metric" if metric else "relative"):
        raise InputError(
            f"{folder}: its depths are {kind}; {'metric' if metric else 'relative'} depths are required here"
        )
    with reading(folder):
        processor = transformers.AutoImageProcessor.from_pretrained(
            folder, local_files_only=True, trust_remote_code=False
        )
    return processor, network.to(device)
