# SPDX-License-Identifier: Apache-2.0
"""LightGlue, which joins key points of two images, through the library kornia.

Lindenberger, Sarlin and Pollefeys, LightGlue: Local Feature Matching at Light Speed, ICCV 2023.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skymoor.engines.libraries import require
from skymoor.engines.weights import load_into
from skymoor.types import Array

if TYPE_CHECKING:
    import torch

Described = tuple[Array, "torch.Tensor"]
"""Pixels (n, 2) of key points, the centre of the first pixel at (0.5, 0.5), and their descriptions (n, d)."""


def lightglue(
    features: str, weights: Path, device: str, *, below: str = "", renamed: Callable[[str], str] = str
) -> Any:
    """The network for key points of these features; `below`, `renamed` and what is raised as of `load_into`."""
    library = require("kornia.feature", "kornia").LightGlue
    # With the name of a feature the library would download weights.
    network = library(features=None, **{**library.features[features], "weights": None})
    load_into(network, weights, below=below, may_miss=("confidence_thresholds",), renamed=renamed)
    return network.to(device).eval()


def join(network: Any, a: Described, b: Described, size_a: tuple[int, int], size_b: tuple[int, int]) -> dict[str, Any]:
    """What the network finds in images of these (width, height): "matches" and "scores", a list of one tensor each."""
    import torch

    inputs = {}
    for name, (px, described), size in (("image0", a, size_a), ("image1", b, size_b)):
        inputs[name] = {
            # LightGlue was trained with the centre of the first pixel at (0, 0).
            "keypoints": torch.from_numpy(px - 0.5).float().to(described.device)[None],
            "descriptors": described[None],
            "image_size": torch.tensor([size], device=described.device),
        }
    with torch.inference_mode():
        found: dict[str, Any] = network(inputs)
    return found
