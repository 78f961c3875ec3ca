# SPDX-License-Identifier: Apache-2.0
"""Pictures of what was rendered and matched."""

from skymoor.report.pictures import (
    confidence_picture,
    difference_picture,
    height_picture,
    match_picture,
    overlay_picture,
    residual_picture,
)

__all__ = [
    "confidence_picture",
    "difference_picture",
    "height_picture",
    "match_picture",
    "overlay_picture",
    "residual_picture",
]
