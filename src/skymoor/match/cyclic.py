# SPDX-License-Identifier: Apache-2.0
"""Matches that find their way back (paper, section 3.2, cyclic consistency)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.types import Array32, Matches2D, Warp


@dataclass(frozen=True)
class CyclicOptions:
    """The paper's thresholds.

    Attributes:
        cycle_px: largest distance, in pixels of a, between a pixel and where it lands after there and back.
        min_confidence: smallest confidence, both ways.
        max_matches: at most so many are drawn at random: neighbours repeat each other.
    """

    cycle_px: float = 2.0
    min_confidence: float = 0.2
    max_matches: int = 5000


def cycle_error_px(warp: Warp) -> Array32:
    """Distance (ha, wa) in pixels of a between each pixel and its image there and back; inf outside b."""
    there = warp.b_from_a
    hb, wb = warp.confidence_b.shape
    u, v = there[..., 0] - 0.5, there[..., 1] - 0.5
    back = cv2.remap(warp.a_from_b, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    h, w = there.shape[:2]
    own = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), axis=-1)
    error = np.linalg.norm(back - own, axis=-1)
    inside = (u >= 0) & (v >= 0) & (u <= wb - 1) & (v <= hb - 1)
    return np.where(inside, error, np.inf).astype(np.float32)


def cyclic_matches(warp: Warp, options: CyclicOptions | None = None, *, rng: np.random.Generator) -> Matches2D:
    """Pixels of a whose match is believed by both directions and returns, and their pixels of b."""
    options = options or CyclicOptions()
    back_confidence = cv2.remap(
        warp.confidence_b, warp.b_from_a[..., 0] - 0.5, warp.b_from_a[..., 1] - 0.5, cv2.INTER_LINEAR
    )
    confidence = np.minimum(warp.confidence_a, back_confidence)
    good = (cycle_error_px(warp) <= options.cycle_px) & (confidence >= options.min_confidence)
    rows, columns = np.nonzero(good)
    if len(rows) > options.max_matches:
        pick = np.sort(rng.choice(len(rows), options.max_matches, replace=False))
        rows, columns = rows[pick], columns[pick]
    return Matches2D(
        np.column_stack([columns + 0.5, rows + 0.5]).astype(np.float64),
        warp.b_from_a[rows, columns].astype(np.float64),
        confidence[rows, columns].astype(np.float64),
    )
