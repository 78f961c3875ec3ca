# SPDX-License-Identifier: Apache-2.0
"""What engines answer, on grids and at points of their own, to flows in the pixels of the images."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from skymoor.types import Array32, Raster, Warp


@dataclass(frozen=True, eq=False)
class EngineFlow:
    """One direction of a learned dense matcher, for an image that was stretched to the engine's grid.

    `target` (h, w, 2) is the place in the other image, x right and y down, -1 and 1 at the outer edges of its border
    pixels; cell (0, 0) stands for the middle of the first of h x w equal parts of the image. That is what PyTorch
    calls align_corners=False. `certainty` (h, w) lies in [0, 1].
    """

    target: Array32
    certainty: Array32


def warp_from_flows(a: Raster, b: Raster, b_from_a: EngineFlow, a_from_b: EngineFlow) -> Warp:
    """Both directions in pixels of the images, which may differ in size and in aspect from the engine's grid.

    Confidence is 0 where the mask is False, of the pixel itself or of where it lands, and where it lands outside.
    """
    flow_a, sure_a = _one_way(b_from_a, a, b)
    flow_b, sure_b = _one_way(a_from_b, b, a)
    return Warp(flow_a, sure_a, flow_b, sure_b)


def _one_way(flow: EngineFlow, source: Raster, target: Raster) -> tuple[Array32, Array32]:
    h, w = source.mask.shape
    # What is resampled is the step from a cell to its target: held at the border, it errs less than a held target.
    step = np.asarray(flow.target, np.float32) - _own_places(flow.target.shape[0], flow.target.shape[1])
    # OpenCV resizes in this convention: equal parts to equal parts, values in their middles.
    place = cv2.resize(step, (w, h), interpolation=cv2.INTER_LINEAR) + _own_places(h, w)
    # Engines clamp what leaves the other image to its edge.
    sure = np.where((np.abs(flow.target) < 1).all(axis=-1), flow.certainty, 0).astype(np.float32)
    sure = cv2.resize(sure, (w, h), interpolation=cv2.INTER_LINEAR)
    size = np.array([target.mask.shape[1], target.mask.shape[0]], np.float32)
    px = (place + 1) / 2 * size
    good = source.mask & _meaningful(px, target)
    return px.astype(np.float32), np.where(good, np.clip(sure, 0, 1), 0).astype(np.float32)


def _own_places(h: int, w: int) -> Array32:
    """(h, w, 2) middles of the cells in the engine's coordinates."""
    x, y = (2 * np.arange(w) + 1) / w - 1, (2 * np.arange(h) + 1) / h - 1
    return np.stack(np.meshgrid(x, y), axis=-1).astype(np.float32)


def _meaningful(px: Array32, target: Raster) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Whether pixels (..., 2) lie on an image, and on its mask."""
    h, w = target.mask.shape
    u, v = px[..., 0], px[..., 1]
    inside = (u > 0) & (v > 0) & (u < w) & (v < h)  # False for NaN
    column, row = (np.where(inside, x, 0).astype(np.intp) for x in (u, v))
    return np.asarray(inside & target.mask[row, column])


def warp_from_pairs(a: Raster, b: Raster, px_a: ArrayLike, px_b: ArrayLike, confidence: ArrayLike) -> Warp:
    """Matched points as a flow that is sure where the points are and says nothing elsewhere.

    Each pair is one pixel of a, and in b the four pixels around its partner, which is what the cyclic test
    interpolates between; so a pair counts once, and comes out where it went in, to a fraction of a pixel. Images
    have about the same scale (see `DenseMatcher`), so from a point to its pixel's centre the step is the same.

    Args:
        a, b: the images, for their sizes and masks.
        px_a, px_b: (n, 2) pixels of matched points; of pairs that share a pixel the surest counts.
        confidence: (n,) in [0, 1].
    """
    px_a, px_b = (np.asarray(px, np.float64).reshape(-1, 2) for px in (px_a, px_b))
    sure = np.asarray(confidence, np.float64).reshape(-1)
    good = _meaningful(px_a.astype(np.float32), a) & _meaningful(px_b.astype(np.float32), b)
    order = np.flatnonzero(good)[np.argsort(sure[good], kind="stable")]  # the surest are painted last
    px_a, px_b, sure = px_a[order], px_b[order], sure[order]
    step = px_b - px_a
    flow_a, sure_a = _nothing(a, b)
    flow_b, sure_b = _nothing(b, a)
    column, row = px_a.astype(np.intp).T
    centre = np.floor(px_a) + 0.5
    flow_a[row, column], sure_a[row, column] = centre + step, sure
    corner = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    here = (np.floor(centre + step - 0.5).astype(np.intp)[:, None] + corner).reshape(-1, 2)
    on = _meaningful(here + np.float32(0.5), b)
    u, v = here[on].T  # still in order of sureness, pair by pair
    flow_b[v, u], sure_b[v, u] = here[on] + 0.5 - np.repeat(step, 4, axis=0)[on], np.repeat(sure, 4)[on]
    return Warp(flow_a, sure_a, flow_b, sure_b)


def _nothing(source: Raster, target: Raster) -> tuple[Array32, Array32]:
    """A finite flow, to about the same place of the other image, with no confidence."""
    h, w = source.mask.shape
    size = np.array([target.mask.shape[1], target.mask.shape[0]], np.float32)
    return ((_own_places(h, w) + 1) / 2 * size).astype(np.float32), np.zeros((h, w), np.float32)
