# SPDX-License-Identifier: Apache-2.0
"""Structural channels, comparable across sensors, seasons and illumination: edge directions and height steps.

Colour: the gradient of the log-image as its double and fourfold angle, so that contrast may reverse and crossing
directions cancel (the family of CFOG, Ye et al. 2019, and HOPC, Ye et al. 2017). Heights: the signed slope, since
illumination cannot reverse it. Magnitudes are compressed relative to their neighbourhood, so that a strong shadow does
not outweigh a street.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array32, Image, Mask, Raster


@dataclass(frozen=True)
class ChannelOptions:
    """Scales and weights of the structural channels.

    Attributes:
        smooth_px: Gaussian sigma before the gradient, in pixels.
        pool_px: Gaussian sigma over which directions are pooled: the spatial tolerance of the comparison.
        local_px: Gaussian sigma of the neighbourhood against which magnitudes are compressed.
        slope: slope (rise over run) at which the height channels saturate.
        height_weight: amplitude of the height channels relative to the colour channels.
    """

    smooth_px: float = 0.8
    pool_px: float = 1.2
    local_px: float = 12.0
    slope: float = 0.5
    height_weight: float = 1.0


HOLE_PX = 2
"""Half width of the widest holes in a mask that are interpolated: about the resolution of the channels."""

N_COLOUR = 4
"""Channels 0 to 3 hold the colour's angles (2, 2, 4, 4), channels 4 and 5 the slope."""


@dataclass(frozen=True, eq=False)
class Channels:
    """Channels (6, h, w), and masks (2, h, w) of known colour and known height, 0 or 1."""

    values: Array32
    known: Array32


def make_channels(raster: Raster, options: ChannelOptions) -> Channels:
    """Channels of a raster; zero where it is masked."""
    colour, colour_mask = _colour(raster.rgb, raster.mask, options)
    if raster.height is None:
        height, height_mask = np.zeros((2, *raster.mask.shape), np.float32), np.zeros(raster.mask.shape, np.float32)
    else:
        height, height_mask = _height(raster.height, options)
    return Channels(np.concatenate([colour, height]), np.stack([colour_mask, height_mask]))


def rotate_angles(values: Array32, radians: float) -> Array32:
    """Channels (6, ...) of an image that was rotated by `radians` from u towards v."""
    rotated = np.empty_like(values)
    for start, order in ((0, 2), (2, 4), (4, 1)):
        c, s = np.float32(np.cos(order * radians)), np.float32(np.sin(order * radians))
        rotated[start] = c * values[start] - s * values[start + 1]
        rotated[start + 1] = s * values[start] + c * values[start + 1]
    return rotated


def _colour(rgb: Image, mask: Mask, options: ChannelOptions) -> tuple[Array32, Array32]:
    inner = _shrink(mask, 2)
    log = np.log(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32) + np.float32(16))
    gu, gv = _gradient(_fill(log, mask), options.smooth_px)
    magnitude = np.hypot(gu, gv) * inner
    # The floor is below a step of one grey level: it suppresses the channels of rounding errors in saturated
    # areas.
    compressed = np.tanh(magnitude / (1.5 * _local_rms(magnitude, inner, options.local_px) + 1e-3))
    c, s = gu / (magnitude + 1e-9), gv / (magnitude + 1e-9)
    c2, s2 = c * c - s * s, 2 * c * s
    c4, s4 = c2 * c2 - s2 * s2, 2 * c2 * s2
    stack = [_blur(compressed * x * inner, options.pool_px) for x in (c2, s2, c4, s4)]
    return _scaled(np.stack(stack), inner, options.local_px), inner


def _height(height: Array32, options: ChannelOptions) -> tuple[Array32, Array32]:
    mask = np.isfinite(height)
    inner = _shrink(mask, 2)
    gu, gv = _gradient(_fill(height, mask), 1.5 * options.smooth_px)
    slope = np.hypot(gu, gv)
    gain = np.tanh(slope / options.slope) / (slope + 1e-9) * inner * options.height_weight
    stack = [_blur(np.asarray(g * gain, dtype=np.float32), options.pool_px) for g in (gu, gv)]
    return np.stack(stack) * inner, inner


def _scaled(stack: Array32, inner: Array32, local_px: float) -> Array32:
    """Divide by the local energy, so that strong texture does not outweigh a single weak edge elsewhere."""
    rms = _local_rms(np.asarray(np.sqrt((stack * stack).sum(axis=0)), dtype=np.float32), inner, 2 * local_px)
    return np.asarray(stack * inner / (rms + 0.1), dtype=np.float32)


def _local_rms(values: Array32, mask: Array32, sigma: float) -> Array32:
    weight = _blur(mask, sigma)
    return np.sqrt(np.maximum(_blur(values * values * mask, sigma), 0) / np.maximum(weight, 1e-3))


def _gradient(values: Array32, sigma: float) -> tuple[Array32, Array32]:
    smooth = _blur(values, sigma)
    return cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=1 / 32), cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=1 / 32)


def _fill(values: Array32, mask: Mask) -> Array32:
    """Extrapolate an image beyond its mask with local means, so that the mask border creates no edge."""
    known = mask.astype(np.float32)
    filled = np.where(mask, values, 0).astype(np.float32)
    for sigma in (2.0, 8.0):
        weight = _blur(known, sigma)
        mean = _blur(np.where(known > 0, filled, 0), sigma) / np.maximum(weight, 1e-6)
        fillable = (known == 0) & (weight > 1e-2)
        filled[fillable] = mean[fillable]
        known[fillable] = 1
    overall = float(values[mask].mean()) if mask.any() else 0.0
    filled[known == 0] = overall
    return filled


def _shrink(mask: Mask, px: int) -> Array32:
    """The mask (h, w) without its border of `px` pixels; scattered holes, which `_fill` interpolates, have no border.

    Otherwise an orthophoto with a hole every few pixels, as stereo leaves them, would not be known anywhere.
    """
    closing = _square(HOLE_PX)
    border = 2 * HOLE_PX
    padded = np.pad(mask.astype(np.uint8), border)  # closing at the image's border, where OpenCV counts all as known
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, closing)[border:-border, border:-border]
    return np.asarray(cv2.erode(closed, _square(px), borderValue=0), dtype=np.float32)


def _square(px: int) -> NDArray[np.uint8]:
    return np.ones((2 * px + 1, 2 * px + 1), np.uint8)


def _blur(values: Array32, sigma: float) -> Array32:
    if sigma > 4:  # a large Gaussian is smooth: three box filters are as good and do not grow with sigma
        width = 2 * int(sigma * 1.0 + 0.5) + 1
        for _ in range(3):
            values = cv2.blur(values, (width, width), borderType=cv2.BORDER_REFLECT)
        return np.asarray(values, dtype=np.float32)
    return np.asarray(cv2.GaussianBlur(values.astype(np.float32, copy=False), (0, 0), sigma), dtype=np.float32)


def rotate_channels(channels: Channels, azimuth: float) -> Channels:
    """Channels of the image rotated by `azimuth` (radians, u towards v), in a square that holds every rotation."""
    h, w = channels.values.shape[1:]
    side = int(np.ceil(np.hypot(h, w))) + 2
    c, s = np.cos(azimuth), np.sin(azimuth)
    linear = np.array([[c, -s], [s, c]])
    offset = side / 2 - linear @ [w / 2, h / 2]
    # OpenCV's origin is the centre of the first pixel.
    matrix = np.column_stack([linear, offset + linear @ [0.5, 0.5] - 0.5])
    stack = np.concatenate([channels.values, channels.known])
    rotated = np.stack([cv2.warpAffine(x, matrix, (side, side), flags=cv2.INTER_LINEAR) for x in stack])
    return Channels(rotate_angles(rotated[:-2], azimuth), rotated[-2:])


def crop_channels(channels: Channels, u0: int, v0: int, side: int) -> Channels:
    """A square window whose first pixel is (u0, v0), zero beyond the image."""
    h, w = channels.values.shape[1:]
    us, ue, vs, ve = max(0, u0), min(w, u0 + side), max(0, v0), min(h, v0 + side)
    windows = [np.zeros((len(stack), side, side), np.float32) for stack in (channels.values, channels.known)]
    if us < ue and vs < ve:
        for window, stack in zip(windows, (channels.values, channels.known), strict=True):
            window[:, vs - v0 : ve - v0, us - u0 : ue - u0] = stack[:, vs:ve, us:ue]
    return Channels(*windows)
