# SPDX-License-Identifier: Apache-2.0
"""Scale bar and north arrow on images that lie on the reference, for those who see them outside the report."""

from __future__ import annotations

import cv2
import numpy as np

from skymoor.results.report.maps import length_words, scale_length
from skymoor.types import Image

LIGHT, DARK = (255, 255, 255), (20, 20, 20)
LEAST_PX = 120  # a smaller image has no room for either


def with_scale(image: Image, pixel_m: float) -> Image:
    """The image (h, w, 3), north up, with a bar of a round length at the lower left and an arrow at the upper right."""
    height, width = image.shape[:2]
    if min(height, width) < LEAST_PX:
        return image
    canvas, length = np.ascontiguousarray(image).copy(), scale_length(width * pixel_m)
    unit = max(1, round(max(height, width) / 500))
    left, foot, end = 10 * unit, height - 10 * unit, 10 * unit + round(length / pixel_m)
    right, top = width - 14 * unit, 8 * unit
    bar = [[left, foot - 5 * unit], [left, foot], [end, foot], [end, foot - 5 * unit]]
    arrow = [
        [right, top],
        [right + 6 * unit, top + 20 * unit],
        [right, top + 15 * unit],
        [right - 6 * unit, top + 20 * unit],
    ]
    for colour, wide in ((DARK, 3 * unit), (LIGHT, unit)):
        cv2.polylines(canvas, [np.array(bar)], isClosed=False, color=colour, thickness=wide, lineType=cv2.LINE_AA)
        cv2.polylines(canvas, [np.array(arrow)], isClosed=True, color=colour, thickness=wide, lineType=cv2.LINE_AA)
        for text, at in (
            (length_words(length), (left + 4 * unit, foot - 5 * unit)),
            ("N", (right - 5 * unit, top + 34 * unit)),
        ):
            cv2.putText(canvas, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45 * unit, colour, wide, cv2.LINE_AA)
    cv2.fillPoly(canvas, [np.array(arrow)], LIGHT, cv2.LINE_AA)
    return canvas
