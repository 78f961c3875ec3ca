# SPDX-License-Identifier: Apache-2.0
"""Figures (h, w, 3) uint8 RGB of arrays: heights, confidence, matches, overlays and residuals."""

from __future__ import annotations

import cv2
import numpy as np

from skymoor.results.report.scale import with_scale
from skymoor.types import Array, Array32, Image, Mask, Matches2D, Raster

GOOD, BAD = (64, 224, 96), (255, 72, 48)


def height_range(height: Array32, percent: float = 0.5) -> tuple[float, float]:
    """The heights (h, w) at both ends of the colours of `height_figure`; some must be known."""
    low, high = np.percentile(height[np.isfinite(height)], [percent, 100 - percent]).tolist()
    return low, high


def height_figure(height: Array32) -> Image:
    """Heights (h, w) as colour with hill shading, black where unknown; the colours span all but the outliers."""
    known = np.isfinite(height)
    if not known.any():
        return np.zeros((*height.shape, 3), np.uint8)
    low, high = height_range(height)
    scaled = np.clip((np.where(known, height, low) - low) / max(high - low, 1e-9), 0, 1)
    colour = cv2.applyColorMap((255 * scaled).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1].astype(np.float32)
    smooth = cv2.GaussianBlur(scaled.astype(np.float32), (0, 0), 1.0)
    shade = cv2.Scharr(smooth, cv2.CV_32F, 1, 0) + cv2.Scharr(smooth, cv2.CV_32F, 0, 1)
    light = 1 + 0.5 * np.tanh(shade / max(float(np.std(shade)) * 2, 1e-9))
    return np.where(known[..., None], np.clip(colour * light[..., None], 0, 255), 0).astype(np.uint8)


def confidence_figure(confidence: Array32) -> Image:
    """Confidence (h, w) in [0, 1], dark to bright."""
    return np.ascontiguousarray(
        cv2.applyColorMap((255 * np.clip(confidence, 0, 1)).astype(np.uint8), cv2.COLORMAP_INFERNO)[..., ::-1]
    )


def match_figure(
    a: Image, b: Image, matches: Matches2D, inliers: Mask | None, *, count: int = 80, side_px: int = 900
) -> Image:
    """Render and reference side by side with lines between matches: green where the transform agrees, red where not."""
    part_b, origin_b = _around(b, matches.px_b) if len(matches) else (b, np.zeros(2))
    left, scale_a = _fitted(a, side_px)
    right, scale_b = _fitted(part_b, side_px)
    canvas = np.zeros((max(len(left), len(right)), left.shape[1] + right.shape[1] + 8, 3), np.uint8)
    canvas[: len(left), : left.shape[1]] = left
    canvas[: len(right), left.shape[1] + 8 :] = right
    pick = np.linspace(0, max(0, len(matches) - 1), min(count, len(matches))).astype(int)
    for k in pick:
        colour = GOOD if inliers is not None and inliers[k] else BAD
        u, v = matches.px_a[k] * scale_a
        x, y = (matches.px_b[k] - origin_b) * scale_b + [left.shape[1] + 8, 0]
        cv2.line(canvas, (round(u), round(v)), (round(x), round(y)), colour, 1, cv2.LINE_AA)
    return canvas


def overlay_figure(warped: Raster, reference: Image, *, tile_m: float = 15.0, pixel_m: float = 0.5) -> Image:
    """The registered render and the reference as a checkerboard: roads and roofs must run on across the fields."""
    h, w = warped.mask.shape
    tile = max(4, round(tile_m / pixel_m))
    rows, columns = np.indices((h, w)) // tile
    mine = ((rows + columns) % 2 == 0) & warped.mask
    mixed = np.where(mine[..., None], warped.rgb, reference)
    area = np.nonzero(warped.mask)
    if not len(area[0]):
        return np.asarray(reference)
    part = tuple(slice(max(0, x.min() - tile), x.max() + tile) for x in area)
    cropped = np.ascontiguousarray(mixed[part])
    zoom = max(1, round(900 / max(cropped.shape[:2])))
    return with_scale(cv2.resize(cropped, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC), pixel_m / zoom)


def residual_figure(reference: Image, px: Array, residuals_m: Array, inliers: Mask, *, pixel_m: float) -> Image:
    """Residuals on the reference: an arrow per position (50 times enlarged), its colour is the vertical residual.

    Blue is too low, white right, red too high by a metre; grey is unknown. Residuals are medians over neighbours.
    """
    part, origin = _around(reference, px) if len(px) else (reference, np.zeros(2))
    canvas, scale = _fitted((part * 0.45).astype(np.uint8), 1000)
    cell = 12.0 / pixel_m
    keys = np.floor(px[inliers] / cell).astype(int)
    for key in np.unique(keys, axis=0):
        mine = (keys == key).all(axis=1)
        east, north = np.median(residuals_m[inliers][mine, :2], axis=0)
        ups = residuals_m[inliers][mine, 2]
        up = float(np.median(ups[np.isfinite(ups)])) if np.isfinite(ups).any() else float("nan")
        u, v = (px[inliers][mine].mean(axis=0) - origin) * scale
        tip = (round(u + 50 * east / pixel_m * scale), round(v - 50 * north / pixel_m * scale))
        colour = _diverging(up)
        cv2.arrowedLine(canvas, (round(u), round(v)), tip, colour, 1, cv2.LINE_AA, tipLength=0.25)
        cv2.circle(canvas, (round(u), round(v)), 3, colour, -1, cv2.LINE_AA)
    return with_scale(canvas, pixel_m / scale)


def difference_figure(metres: Array32, *, reach_m: float = 3.0) -> Image:
    """Heights (h, w) that differ: blue is too low, white right, red too high by `reach_m`; dark grey where unknown."""
    known = np.isfinite(metres)
    share = np.clip(np.where(known, metres, 0) / reach_m, -1, 1)[..., None]
    white, red, blue = np.array([246.0] * 3), np.array([200.0, 36.0, 28.0]), np.array([28.0, 78.0, 200.0])
    colour = white + np.abs(share) * (np.where(share > 0, red, blue) - white)
    return np.where(known[..., None], colour, 48).astype(np.uint8)


def _diverging(up: float) -> tuple[int, int, int]:
    if not np.isfinite(up):
        return (150, 150, 150)
    share = float(np.clip(up, -1, 1))
    fade = round(255 * (1 - abs(share)))
    return (255, fade, fade) if share > 0 else (fade, fade, 255)


def _around(image: Image, px: Array, border: float = 0.1) -> tuple[Image, Array]:
    """The part of an image that holds the pixels, with a border, and its first pixel."""
    low, high = px.min(axis=0), px.max(axis=0)
    margin = border * (high - low).max() + 8
    limit = np.array(image.shape[1::-1])
    low = np.clip(np.floor(low - margin), 0, limit - 1).astype(int)
    high = np.clip(np.ceil(high + margin), low + 1, limit).astype(int)
    return image[low[1] : high[1], low[0] : high[0]], low.astype(float)


def _fitted(image: Image, side_px: int) -> tuple[Image, float]:
    scale = side_px / max(image.shape[:2])
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.ascontiguousarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=how)), scale
