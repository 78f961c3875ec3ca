# SPDX-License-Identifier: Apache-2.0
"""Painted walls: brick, plaster, concrete, metal sheets and panels, in linear light.

Row 0 of a picture is its top. All lengths are metres; `texel_m` is the size of a texel.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array32 = NDArray[np.float32]
Rng = np.random.Generator
Shape = tuple[int, int]

COLOURS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "brick": (
        (0.30, 0.125, 0.085),
        (0.25, 0.14, 0.10),
        (0.36, 0.21, 0.14),
        (0.20, 0.13, 0.11),
        (0.40, 0.31, 0.20),
        (0.33, 0.30, 0.27),
    ),
    "plaster": (
        (0.58, 0.52, 0.41),
        (0.52, 0.50, 0.46),
        (0.50, 0.41, 0.29),
        (0.44, 0.46, 0.40),
        (0.55, 0.46, 0.39),
        (0.38, 0.40, 0.43),
    ),
    "concrete": ((0.38, 0.37, 0.34), (0.32, 0.32, 0.31), (0.42, 0.39, 0.34)),
    "metal": ((0.42, 0.44, 0.45), (0.20, 0.27, 0.33), (0.48, 0.46, 0.40), (0.22, 0.28, 0.22), (0.34, 0.35, 0.36)),
    "panels": ((0.48, 0.48, 0.47), (0.30, 0.31, 0.33), (0.50, 0.45, 0.38), (0.34, 0.22, 0.16), (0.24, 0.29, 0.33)),
}
"""Linear albedo of the walls of each material, red-green-blue."""


def noise(rng: Rng, shape: Shape, texel_m: float, size_m: float | tuple[float, float]) -> Array32:
    """Smooth noise about 0 of deviation about 0.8, with blotches of `size_m`, or of (height, width)."""
    tall, wide = size_m if isinstance(size_m, tuple) else (size_m, size_m)
    grid = max(2, round(shape[0] * texel_m / tall) + 1), max(2, round(shape[1] * texel_m / wide) + 1)
    if grid[0] >= shape[0] and grid[1] >= shape[1]:
        return rng.standard_normal(shape, dtype=np.float32)
    smooth: Array32 = cv2.resize(
        rng.standard_normal(grid, dtype=np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC
    )
    return smooth


def octaves(
    rng: Rng, shape: Shape, texel_m: float, amount: float = 0.07, largest_m: float = 9.0, smallest_m: float = 0.035
) -> Array32:
    """Noise about 0 of every size from the largest to the smallest, each of deviation `amount`."""
    field, size_m = np.zeros((2, 2), np.float32), largest_m
    while size_m > smallest_m / 2:
        grid = (
            min(shape[0], max(2, round(shape[0] * texel_m / size_m) + 1)),
            min(shape[1], max(2, round(shape[1] * texel_m / size_m) + 1)),
        )
        field = cv2.resize(field, (grid[1], grid[0]), interpolation=cv2.INTER_LINEAR)
        field += amount * rng.standard_normal(grid, dtype=np.float32)
        size_m /= 2
    whole: Array32 = cv2.resize(field, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
    return whole


def joint(position_m: ArrayLike, period_m: float, width_m: float, texel_m: float) -> Array32:
    """How much of each texel lies in a joint, for joints of `width_m` at every multiple of the period."""
    x = np.asarray(position_m, np.float64)
    away = np.abs(x - np.round(x / period_m) * period_m)
    cover = np.clip(((width_m + texel_m) / 2 - away) / texel_m, 0, min(width_m / texel_m, 1.0))
    return cover.astype(np.float32)


def blend(albedo: Array32, cover: ArrayLike, colour: ArrayLike) -> None:
    """Paint over `albedo` (h, w, 3) in place, where `cover` (h, w) in [0, 1] says."""
    albedo += np.asarray(cover, np.float32)[..., None] * (np.asarray(colour, np.float32) - albedo)


def centres(shape: Shape, texel_m: float) -> tuple[Array32, Array32]:
    """Middle of each row (h, 1), down, and of each column (1, w), to the right."""
    y = (np.arange(shape[0], dtype=np.float32)[:, None] + np.float32(0.5)) * np.float32(texel_m)
    x = (np.arange(shape[1], dtype=np.float32)[None, :] + np.float32(0.5)) * np.float32(texel_m)
    return y, x


def wall_texture(material: str, rng: Rng, shape: Shape, texel_m: float, colour: ArrayLike) -> Array32:
    """A clean wall (h, w, 3) of a material of about the linear `colour` (3,); `rng` decides all details."""
    painters = {"brick": brick, "plaster": plaster, "concrete": concrete, "metal": metal, "panels": panels}
    albedo = painters[material](rng, shape, texel_m, np.asarray(colour, np.float32))
    albedo *= (1 + octaves(rng, shape, texel_m, 0.04 if material == "metal" else 0.055))[..., None]
    warm = noise(rng, shape, texel_m, 2.5) * np.float32(0.025)
    albedo[..., 0] *= 1 + warm
    albedo[..., 2] *= 1 - warm
    return albedo


def brick(rng: Rng, shape: Shape, texel_m: float, colour: Array32) -> Array32:
    """Running bond: every brick its own tint, some burnt, with mortar between."""
    length, course = rng.choice([0.24, 0.22, 0.30]), rng.choice([0.075, 0.083, 0.10])
    y, x = centres(shape, texel_m)
    row = (y[:, 0] // course).astype(np.int32)
    shifted = x + (row[:, None] % 2) * length / 2
    column = (shifted // length).astype(np.int32)
    table = _brick_tints(rng, (int(row.max()) + 1, int(column.max()) + 1), colour)
    albedo: Array32 = table[row[:, None], column]
    mortar = np.maximum(joint(shifted, length, 0.012, texel_m), joint(y, course, 0.012, texel_m))
    blend(albedo, mortar * 0.9, float(rng.uniform(0.75, 1.5)) * colour.mean() * np.array([1.05, 1.0, 0.92]))
    return albedo


def _brick_tints(rng: Rng, count: Shape, colour: Array32) -> Array32:
    other = colour * rng.uniform(0.85, 1.15, 3).astype(np.float32) * np.float32(rng.uniform(0.65, 1.25))
    mix = np.clip(rng.normal(0.3, 0.3, count), 0, 1).astype(np.float32)[..., None]
    table = colour * (1 - mix) + other * mix
    table *= np.exp(rng.normal(0, 0.13, (*count, 1))).astype(np.float32)
    burnt = rng.random(count) < rng.uniform(0.02, 0.09)
    table[burnt] *= np.float32(0.55)
    return np.asarray(np.clip(table, 0.02, 0.75), np.float32)


def plaster(rng: Rng, shape: Shape, texel_m: float, colour: Array32) -> Array32:
    """Painted render: blotches, trowel marks and grain."""
    shade = 1 + 0.06 * noise(rng, shape, texel_m, 1.3) + 0.05 * noise(rng, shape, texel_m, (0.12, 0.5))
    shade += 0.05 * rng.standard_normal(shape, dtype=np.float32)
    albedo: Array32 = shade[..., None] * colour
    old = np.clip(2.5 * noise(rng, shape, texel_m, 3.0) - 1.2, 0, 1)
    blend(albedo, old * np.float32(0.5), colour * rng.uniform(0.7, 0.95))
    return albedo


def concrete(rng: Rng, shape: Shape, texel_m: float, colour: Array32) -> Array32:
    """Cast in formwork: a tint for each lift and sheet, joints, tie holes, small voids."""
    wide, tall = rng.choice([2.4, 1.8, 1.25]), rng.choice([1.2, 1.5, 2.5])
    y, x = centres(shape, texel_m)
    row, column = (y // tall).astype(np.int32), (x // wide).astype(np.int32)
    tints = np.exp(rng.normal(0, 0.08, (int(row.max()) + 1, int(column.max()) + 1))).astype(np.float32)
    shade = tints[row, column] * (1 + 0.07 * noise(rng, shape, texel_m, (0.9, 0.12)))
    shade *= 1 - 0.35 * np.maximum(joint(x, wide, 0.02, texel_m), joint(y, tall, 0.025, texel_m))
    dx = np.abs(np.abs(x % wide - wide / 2) - wide / 4)
    dy = np.abs(np.abs(y % tall - tall / 2) - tall / 4)
    shade *= 1 - 0.55 * np.clip((0.03 + texel_m / 2 - np.sqrt(dx * dx + dy * dy)) / texel_m, 0, 1)
    shade *= np.where(rng.random(shape, dtype=np.float32) < 0.012, np.float32(0.7), np.float32(1))
    albedo: Array32 = shade[..., None] * colour
    return albedo


def metal(rng: Rng, shape: Shape, texel_m: float, colour: Array32) -> Array32:
    """Ribbed sheets: the ribs' light and dark sides, sheets a metre wide of slightly other age, laps and screws."""
    y, x = centres(shape, texel_m)
    period, sheet, lap = rng.choice([0.2, 0.25, 0.333]), 1.0, rng.uniform(2.8, 4.5)
    phase = (x % period) / period
    rib = 1 + 0.14 * np.where(phase < 0.16, 1, 0) - 0.34 * np.where((phase > 0.5) & (phase < 0.68), 1, 0)
    row, column = (y // lap).astype(np.int32), (x // sheet).astype(np.int32)
    tints = np.exp(rng.normal(0, 0.06, (int(row.max()) + 1, int(column.max()) + 1))).astype(np.float32)
    shade = tints[row, column] * rib.astype(np.float32)
    shade *= 1 - 0.25 * np.maximum(joint(y, lap, 0.03, texel_m), joint(x, sheet, 0.02, texel_m))
    screws = joint(y, lap / 3, 0.03, texel_m) * joint(x, period, 0.03, texel_m)
    albedo: Array32 = (shade * (1 - 0.45 * screws))[..., None] * colour
    blend(albedo, 0.7 * rust(rng, shape, texel_m), (0.16, 0.08, 0.045))
    return albedo


def rust(rng: Rng, shape: Shape, texel_m: float) -> Array32:
    """Cover (h, w) of rust: ragged spots in some regions, drawn down by the rain."""
    where = 1.3 * noise(rng, shape, texel_m, 4.0) + 0.8 * noise(rng, shape, texel_m, (0.5, 0.12))
    ragged = where + 0.6 * noise(rng, shape, texel_m, (0.12, 0.05)) + 0.7 * noise(rng, shape, texel_m, (1.5, 0.07))
    return np.asarray(np.clip(0.8 * (ragged - 2.5), 0, 1), np.float32)


def panels(rng: Rng, shape: Shape, texel_m: float, colour: Array32) -> Array32:
    """Cladding panels with open joints; a few panels newer, or of another colour."""
    wide, tall = rng.choice([1.2, 1.5, 0.9, 3.0]), rng.choice([0.6, 1.0, 1.65, 3.3])
    y, x = centres(shape, texel_m)
    row, column = (y // tall).astype(np.int32), (x // wide).astype(np.int32)
    count = int(row.max()) + 1, int(column.max()) + 1
    tints = np.exp(rng.normal(0, 0.05, (*count, 1))) * colour
    accent = rng.random(count) < rng.choice([0.0, 0.03, 0.12])
    tints[accent] = np.clip(colour * rng.uniform(0.5, 1.4) * rng.uniform(0.85, 1.15, 3), 0.05, 0.6)
    albedo: Array32 = tints.astype(np.float32)[row, column]
    slope = np.float32(0.05) * ((y % tall) / tall - 0.5) + np.float32(0.02) * noise(rng, shape, texel_m, 0.4)
    albedo *= (1 - slope)[..., None]
    gap = np.maximum(joint(x, wide, 0.022, texel_m), joint(y, tall, 0.022, texel_m))
    blend(albedo, gap * np.float32(0.8), colour * 0.15)
    return albedo


def grain(rng: Rng, texel_m: float = 0.02, size_m: float = 2.0, amount: float = 0.06) -> Array32:
    """A small, nearly white page for things that take their colour from a tint: worn paint, dust, scratches."""
    n = round(size_m / texel_m)
    shade = 0.92 + octaves(rng, (n, n), texel_m, amount, largest_m=1.0)
    shade += 0.03 * noise(rng, (n, n), texel_m, (0.6, 0.03))
    return np.repeat(np.clip(shade, 0.3, 1.0)[..., None], 3, axis=2)
