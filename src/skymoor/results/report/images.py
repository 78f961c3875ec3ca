# SPDX-License-Identifier: Apache-2.0
"""Pictures as parts of a page: small JPEGs in the text itself."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

from skymoor.engines.tensors import fitted
from skymoor.types import Image

SIDE_PX, QUALITY = 1200, 80


def data_uri(rgb: Image, side_px: int = SIDE_PX) -> str:
    """An image (h, w, 3) as a data URI, reduced if it is larger than the page can use."""
    small, _ = fitted(np.ascontiguousarray(rgb), side_px, 1)
    content = io.BytesIO()
    Pillow.fromarray(small).save(content, "JPEG", quality=QUALITY, optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(content.getvalue()).decode()


def file_uri(path: Path, side_px: int = SIDE_PX) -> str | None:
    """An image of the run as `data_uri`; None where it is missing or damaged."""
    try:
        with Pillow.open(path) as image:
            return data_uri(np.asarray(image.convert("RGB")), side_px)
    except OSError:
        return None


def png_uri(rgba: Image) -> str:
    """A small image (h, w, 4) with transparent parts as a data URI."""
    content = io.BytesIO()
    Pillow.fromarray(rgba).save(content, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode()
