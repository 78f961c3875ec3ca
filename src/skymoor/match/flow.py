# SPDX-License-Identifier: Apache-2.0
"""Conversion of matchers' outputs, on their own grids or at points, to dense flows in image pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from skymoor.types import Array32, Raster, Warp


@dataclass(frozen=True, eq=False)
class EngineFlow:
    """One direction of a learned dense matcher, for an image resized to the engine's grid.

    `target` (h, w, 2) is the position in the other image, x right and y down, -1 and 1 at the outer edges of its border
    pixels; cell (0, 0) is the centre of the first of h x w equal cells of the image (PyTorch's align_corners=False).
    `certainty` (h, w) is in [0, 1].
    """

    target: Array32
    certainty: Array32


def warp_from_flows(a: Raster, b: Raster, b_from_a: EngineFlow, a_from_b: EngineFlow) -> Warp:
    """Both directions in image pixels; the images may differ in size and aspect from the engine's grid.

    Confidence is 0 for masked pixels and for pixels whose target is masked or outside the image.
    """
    flow_a, confidence_a = _one_way(b_from_a, a, b)
    flow_b, confidence_b = _one_way(a_from_b, b, a)
    return Warp(flow_a, confidence_a, flow_b, confidence_b)


def _one_way(flow: EngineFlow, source: Raster, target: Raster) -> tuple[Array32, Array32]:
    h, w = source.mask.shape
    # Displacements are resampled, not targets: replicated at the border, they err less.
    step = np.asarray(flow.target, np.float32) - _cell_centres(flow.target.shape[0], flow.target.shape[1])
    # OpenCV resizes by the same convention: values at the centres of equal cells.
    position = cv2.resize(step, (w, h), interpolation=cv2.INTER_LINEAR) + _cell_centres(h, w)
    # Engines clamp targets outside the other image to its edge.
    certainty = np.where((np.abs(flow.target) < 1).all(axis=-1), flow.certainty, 0).astype(np.float32)
    certainty = cv2.resize(certainty, (w, h), interpolation=cv2.INTER_LINEAR)
    size = np.array([target.mask.shape[1], target.mask.shape[0]], np.float32)
    px = (position + 1) / 2 * size
    valid = source.mask & _on_mask(px, target)
    return px.astype(np.float32), np.where(valid, np.clip(certainty, 0, 1), 0).astype(np.float32)


def _cell_centres(h: int, w: int) -> Array32:
    """(h, w, 2) centres of the cells in the engine's coordinates."""
    x, y = (2 * np.arange(w) + 1) / w - 1, (2 * np.arange(h) + 1) / h - 1
    return np.stack(np.meshgrid(x, y), axis=-1).astype(np.float32)


def _on_mask(px: Array32, target: Raster) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Whether pixels (..., 2) lie inside an image and on its mask."""
    h, w = target.mask.shape
    u, v = px[..., 0], px[..., 1]
    inside = (u > 0) & (v > 0) & (u < w) & (v < h)  # False for NaN
    column, row = (np.where(inside, x, 0).astype(np.intp) for x in (u, v))
    return np.asarray(inside & target.mask[row, column])


def warp_from_pairs(a: Raster, b: Raster, px_a: ArrayLike, px_b: ArrayLike, confidence: ArrayLike) -> Warp:
    """Sparse matches as a dense flow with zero confidence away from the points.

    Each pair sets one pixel of a, and in b the four pixels around its partner, between which the cyclic test
    interpolates: a pair counts once and is recovered with subpixel accuracy. The images have about the same scale
    (see `DenseMatcher`), so that the displacement of a point is also that of its pixel's centre.

    Args:
        a, b: the images; their sizes and masks are used.
        px_a, px_b: (n, 2) pixels of matched points; of pairs that share a pixel, the most confident is kept.
        confidence: (n,) in [0, 1].
    """
    px_a, px_b = (np.asarray(px, np.float64).reshape(-1, 2) for px in (px_a, px_b))
    weight = np.asarray(confidence, np.float64).reshape(-1)
    valid = _on_mask(px_a.astype(np.float32), a) & _on_mask(px_b.astype(np.float32), b)
    order = np.flatnonzero(valid)[np.argsort(weight[valid], kind="stable")]  # the most confident are written last
    px_a, px_b, weight = px_a[order], px_b[order], weight[order]
    step = px_b - px_a
    flow_a, confidence_a = _zero_confidence(a, b)
    flow_b, confidence_b = _zero_confidence(b, a)
    column, row = px_a.astype(np.intp).T
    centre = np.floor(px_a) + 0.5
    flow_a[row, column], confidence_a[row, column] = centre + step, weight
    corner = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    neighbours = (np.floor(centre + step - 0.5).astype(np.intp)[:, None] + corner).reshape(-1, 2)
    on = _on_mask(neighbours + np.float32(0.5), b)
    u, v = neighbours[on].T  # still by increasing confidence, pair by pair
    flow_b[v, u], confidence_b[v, u] = neighbours[on] + 0.5 - np.repeat(step, 4, axis=0)[on], np.repeat(weight, 4)[on]
    return Warp(flow_a, confidence_a, flow_b, confidence_b)


def _zero_confidence(source: Raster, target: Raster) -> tuple[Array32, Array32]:
    """A finite flow to the corresponding relative position in the other image, with zero confidence."""
    h, w = source.mask.shape
    size = np.array([target.mask.shape[1], target.mask.shape[0]], np.float32)
    return ((_cell_centres(h, w) + 1) / 2 * size).astype(np.float32), np.zeros((h, w), np.float32)
