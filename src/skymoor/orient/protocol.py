# SPDX-License-Identifier: Apache-2.0
"""Interface of the ground segmentation that the orientation uses."""

from __future__ import annotations

from typing import Protocol

from skymoor.types import Image, Mask


class GroundLabeler(Protocol):
    """Segments the ground in a photo."""

    def __call__(self, image: Image) -> Mask:
        """Whether each pixel (h, w) of an image (h, w, 3) shows ground: soil, grass, pavement or water."""
