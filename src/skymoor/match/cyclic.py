# SPDX-License-Identifier: Apache-2.0
"""Cyclically consistent matches (paper, section 3.2)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.types import Array32, Matches2D, Warp


@dataclass(frozen=True)
class CyclicOptions:
    """Thresholds of the cyclic consistency test (defaults: the paper's).

    Attributes:
        cycle_px: largest forward-backward error, in pixels of a.
        min_confidence: smallest confidence (0 to 1) in both directions.
        max_matches: larger sets are subsampled at random to this size: neighbouring matches are redundant.
    """

    cycle_px: float = 2.0
    min_confidence: float = 0.2
    max_matches: int = 5000


def cycle_error_px(warp: Warp) -> Array32:
    """Forward-backward error (ha, wa) of each pixel of a, in pixels of a; inf for pixels mapped outside b."""
    forward = warp.b_from_a
    hb, wb = warp.confidence_b.shape
    u, v = forward[..., 0] - 0.5, forward[..., 1] - 0.5
    returned = cv2.remap(warp.a_from_b, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    h, w = forward.shape[:2]
    identity = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), axis=-1)
    error = np.linalg.norm(returned - identity, axis=-1)
    inside = (u >= 0) & (v >= 0) & (u <= wb - 1) & (v <= hb - 1)
    return np.where(inside, error, np.inf).astype(np.float32)


def cyclic_matches(warp: Warp, options: CyclicOptions | None = None, *, rng: np.random.Generator) -> Matches2D:
    """Matches that are confident in both directions and cyclically consistent, at most `max_matches`."""
    options = options or CyclicOptions()
    back_confidence = cv2.remap(
        warp.confidence_b, warp.b_from_a[..., 0] - 0.5, warp.b_from_a[..., 1] - 0.5, cv2.INTER_LINEAR
    )
    confidence = np.minimum(warp.confidence_a, back_confidence)
    consistent = (cycle_error_px(warp) <= options.cycle_px) & (confidence >= options.min_confidence)
    rows, columns = np.nonzero(consistent)
    if len(rows) > options.max_matches:
        subset = np.sort(rng.choice(len(rows), options.max_matches, replace=False))
        rows, columns = rows[subset], columns[subset]
    return Matches2D(
        np.column_stack([columns + 0.5, rows + 0.5]).astype(np.float64),
        warp.b_from_a[rows, columns].astype(np.float64),
        confidence[rows, columns].astype(np.float64),
    )
