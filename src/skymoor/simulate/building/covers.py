# SPDX-License-Identifier: Apache-2.0
"""Painted roofs and the faces of machines on them, in linear light; row 0 of a roof is its ridge or any side."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from skymoor.simulate.building.materials import Array32, Rng, Shape, blend, centres, joint, noise, octaves, rust
from skymoor.simulate.building.weathering import spots

COLOURS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "membrane": ((0.46, 0.46, 0.44), (0.13, 0.13, 0.135), (0.30, 0.30, 0.29), (0.22, 0.23, 0.22)),
    "gravel": ((0.30, 0.28, 0.25), (0.36, 0.34, 0.31), (0.24, 0.23, 0.22)),
    "tiles": ((0.27, 0.105, 0.06), (0.10, 0.10, 0.105), (0.20, 0.11, 0.075), (0.33, 0.17, 0.10)),
    "metal": ((0.38, 0.39, 0.40), (0.13, 0.19, 0.16), (0.22, 0.08, 0.06), (0.20, 0.22, 0.25)),
}
"""Linear albedo of roofs."""


def roof_texture(cover: str, rng: Rng, shape: Shape, texel_m: float, colour: ArrayLike, *, plain: bool) -> Array32:
    """A roof (h, w, 3) of about the linear `colour` (3,); a `plain` one gives the eye next to nothing to hold on to."""
    painters = {"membrane": _membrane, "gravel": _gravel, "tiles": _tiles, "metal": _sheets}
    tone = np.asarray(colour, np.float32)
    contrast = np.float32(0.22 if plain else 1.0)
    albedo = painters[cover](rng, shape, texel_m, tone, contrast)
    albedo *= (1 + contrast * octaves(rng, shape, texel_m, 0.05))[..., None]
    return np.asarray(np.clip(albedo, 0.02, 0.75), np.float32)


def _membrane(rng: Rng, shape: Shape, texel_m: float, colour: Array32, contrast: np.float32) -> Array32:
    """Welded sheets: seams with a light and a dark side, patches, dried puddles, footprints of old machines."""
    y, x = centres(shape, texel_m)
    wide, long = rng.uniform(1.0, 2.0), rng.uniform(7, 14)
    sheet = (y // wide).astype(np.int32)
    shift = rng.uniform(0, long, int(sheet.max()) + 1).astype(np.float32)[sheet]
    piece = ((x + shift) // long).astype(np.int32)
    tints = np.exp(rng.normal(0, 0.035, (int(sheet.max()) + 1, int(piece.max()) + 1))).astype(np.float32)
    shade = 1 + contrast * (tints[sheet, piece] - 1)
    seam = np.maximum(joint(y, wide, 0.05, texel_m), joint(x + shift, long, 0.05, texel_m))
    shade *= 1 - contrast * (0.22 * seam - 0.12 * joint(y - 0.08, wide, 0.04, texel_m))
    pond = noise(rng, shape, texel_m, 4.0) + 0.35 * noise(rng, shape, texel_m, 0.8)
    ring = np.exp(-(((pond - 1.0) / 0.12) ** 2)) + 0.5 * np.clip(3 * (pond - 1.0), 0, 1)
    albedo: Array32 = shade[..., None] * colour
    blend(albedo, 0.35 * contrast * ring, (0.17, 0.155, 0.13))
    _patches(albedo, rng, texel_m, float(contrast))
    blend(albedo, contrast * 0.5 * spots(shape, rng, texel_m, 0.05, (0.04, 0.35)), colour * 0.55)
    return albedo


def _patches(albedo: Array32, rng: Rng, texel_m: float, contrast: float) -> None:
    h, w = albedo.shape[:2]
    for _ in range(rng.poisson(h * w * texel_m**2 / 45)):
        tall, wide = (max(2, int(size / texel_m)) for size in rng.uniform((0.3, 0.3), (1.6, 3.0)))
        top, left = int(rng.uniform(0, h)), int(rng.uniform(0, w))
        tone = np.exp(contrast * rng.normal(0, 0.22))
        albedo[top : top + tall, left : left + wide] *= np.float32(tone)
        albedo[top : top + 2, left : left + wide] *= np.float32(1 - 0.25 * contrast)


def _gravel(rng: Rng, shape: Shape, texel_m: float, colour: Array32, contrast: np.float32) -> Array32:
    """Pebbles of all greys, swept bare in places, with moss where water stays."""
    speckle = np.exp(contrast * 0.22 * rng.standard_normal(shape, dtype=np.float32))
    albedo: Array32 = (speckle * (1 + contrast * 0.10 * noise(rng, shape, texel_m, 1.5)))[..., None] * colour
    bare = np.clip(2.2 * noise(rng, shape, texel_m, 2.2) + 0.8 * noise(rng, shape, texel_m, 0.3) - 2.9, 0, 1)
    blend(albedo, 0.7 * contrast * bare, (0.12, 0.12, 0.12))
    moss = np.clip(1.8 * noise(rng, shape, texel_m, 3.0) + noise(rng, shape, texel_m, 0.25) - 2.3, 0, 1)
    blend(albedo, 0.65 * contrast * moss, (0.09, 0.115, 0.04))
    return albedo


def _tiles(rng: Rng, shape: Shape, texel_m: float, colour: Array32, contrast: np.float32) -> Array32:
    """Courses of tiles with a shadow under each edge, each tile its own tint, some replaced, lichen."""
    y, x = centres(shape, texel_m)
    course, wide = rng.uniform(0.28, 0.36), rng.uniform(0.2, 0.3)
    row, column = (y // course).astype(np.int32), (x // wide).astype(np.int32)
    count = int(row.max()) + 1, int(column.max()) + 1
    table = np.exp(contrast * rng.normal(0, 0.13, (*count, 1))) * colour
    table[rng.random(count) < 0.015] *= rng.choice([0.6, 1.5])
    albedo: Array32 = table.astype(np.float32)[row, column]
    roll = 1 + 0.14 * np.cos(2 * np.pi * x / wide)
    lip = 1 - 0.42 * joint(y, course, 0.05, texel_m) - 0.15 * joint(x, wide, 0.03, texel_m)
    albedo *= (roll * lip).astype(np.float32)[..., None]
    lichen = spots(shape, rng, texel_m, 0.6, (0.04, 0.14)) * np.clip(0.5 + noise(rng, shape, texel_m, 3.0), 0, 1)
    blend(albedo, 0.5 * contrast * lichen, (0.30, 0.31, 0.22))
    moss = np.clip(
        1.5 * noise(rng, shape, texel_m, 2.0) + noise(rng, shape, texel_m, 0.3) - 2.4 + 0.6 * y / y.max(), 0, 1
    )
    blend(albedo, 0.6 * contrast * moss, (0.06, 0.075, 0.03))
    return albedo


def _sheets(rng: Rng, shape: Shape, texel_m: float, colour: Array32, contrast: np.float32) -> Array32:
    """Standing seams down the slope, sheets of other ages, rust and stains that run with the water."""
    y, x = centres(shape, texel_m)
    seam, lap = rng.uniform(0.4, 0.6), rng.uniform(4, 7)
    row, column = (y // lap).astype(np.int32), (x // (2 * seam)).astype(np.int32)
    tints = np.exp(contrast * rng.normal(0, 0.07, (int(row.max()) + 1, int(column.max()) + 1))).astype(np.float32)
    rib = 1 - 0.3 * joint(x, seam, 0.05, texel_m) + 0.15 * joint(x - 0.06, seam, 0.04, texel_m)
    shade = tints[row, column] * rib * (1 - 0.25 * joint(y, lap, 0.04, texel_m))
    shade *= 1 + contrast * 0.08 * noise(rng, shape, texel_m, (3.0, 0.15))
    albedo: Array32 = shade[..., None] * colour
    blend(albedo, 0.7 * contrast * rust(rng, shape, texel_m), (0.17, 0.085, 0.045))
    return albedo


def louvre(rng: Rng) -> Array32:
    """Slats of a machine, light, for a tint; texels of 2 cm."""
    y, _ = centres((50, 60), 0.02)
    shade = 0.8 - 0.6 * joint(y, 0.1, 0.05, 0.02) + 0.05 * noise(rng, (50, 60), 0.02, 0.3)
    return np.repeat(np.clip(shade, 0.05, 1)[..., None], 3, axis=2)


def fan(rng: Rng) -> Array32:
    """A fan in its ring, one metre square."""
    disc = np.full((50, 50, 3), 0.30, np.float32)
    cv2.circle(disc, (25, 25), 23, (0.03, 0.03, 0.03), -1, cv2.LINE_AA)
    turn = float(rng.uniform(0, 90))
    for k in range(5):
        cv2.ellipse(disc, (25, 25), (21, 21), turn + 72 * k, 0, 38, (0.14, 0.14, 0.14), -1, cv2.LINE_AA)
    cv2.circle(disc, (25, 25), 5, (0.2, 0.2, 0.2), -1, cv2.LINE_AA)
    return disc


def solar(rng: Rng) -> Array32:
    """Cells in panels of one metre by one, dark blue with thin light lines."""
    shape = (50, 100)
    y, x = centres(shape, 0.02)
    line = np.maximum(joint(x, 1.0, 0.04, 0.02), joint(y, 1.0, 0.04, 0.02))
    cell = np.maximum(joint(x, 1 / 6, 0.008, 0.02), joint(y, 1 / 6, 0.008, 0.02))
    tone = np.array([0.012, 0.018, 0.045], np.float32) * (1 + 0.15 * noise(rng, shape, 0.02, 0.4))[..., None]
    return np.asarray(tone + (0.28 * line + 0.06 * cell)[..., None], np.float32)
