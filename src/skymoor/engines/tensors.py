# SPDX-License-Identifier: Apache-2.0
"""Pictures as networks want them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from skymoor.types import Array, Image

if TYPE_CHECKING:
    import torch


def fitted(rgb: Image, side_px: int, multiple: int) -> tuple[Image, Array]:
    """An image stretched so that its sides are multiples and at most about `side_px`; never enlarged by more.

    Returns:
        the image (h, w, 3), and by how much (2,) its pixels are multiplied to be those of the given one.
    """
    h, w = rgb.shape[:2]
    ratio = min(1.0, side_px / max(h, w))
    size = tuple(max(multiple, multiple * round(side * ratio / multiple)) for side in (w, h))
    if size == (w, h):
        return rgb, np.ones(2)
    shrinks = size[0] < w or size[1] < h
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    return np.asarray(small, np.uint8), np.array([w, h]) / size


def as_tensor(image: Image, device: str) -> torch.Tensor:
    """(1, channels, h, w) in [0, 1] of an image (h, w, channels) or (h, w)."""
    import torch

    channels = image[..., None] if image.ndim == 2 else image
    return torch.from_numpy(np.ascontiguousarray(channels)).permute(2, 0, 1)[None].to(device).float() / 255
