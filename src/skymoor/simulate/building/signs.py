# SPDX-License-Identifier: Apache-2.0
"""Painted boards with words: names of firms, house numbers, warnings, posters."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.simulate.building.materials import Array32, Rng, blend, noise, octaves
from skymoor.simulate.mesh import Array

_HEADS = ("NOR", "BEL", "VAN", "KER", "TAL", "MIR", "OST", "HAL", "LUN", "GRA", "SOL", "DRE", "FEN", "RAD")
_TAILS = ("TEK", "DOR", "VIK", "MARK", "TRANS", "LOG", "NEX", "MED", "FLEX", "CO", "BAU", "SON", "LINE")
_TRADES = ("LOGISTICS", "PRINT", "DENTAL", "STORAGE", "LEGAL", "TYRES", "FOODS", "DESIGN", "OPTICS", "SUPPLY", "CAFE")
_WARNINGS = ("NO PARKING", "DELIVERIES", "KEEP CLEAR", "CCTV", "PRIVATE", "EXIT", "STAFF ONLY", "DANGER")
_BOARDS = (
    (0.50, 0.50, 0.48),
    (0.06, 0.10, 0.20),
    (0.22, 0.05, 0.045),
    (0.05, 0.12, 0.08),
    (0.05, 0.05, 0.055),
    (0.45, 0.36, 0.12),
)
_FONTS = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX, cv2.FONT_HERSHEY_COMPLEX)


def firm(rng: Rng) -> str:
    """A name that no firm has, one hopes."""
    name = str(rng.choice(_HEADS)) + str(rng.choice(_TAILS))
    return f"{name} {rng.choice(_TRADES)}" if rng.random() < 0.6 else name


def warning(rng: Rng) -> str:
    """What small signs say."""
    return str(rng.choice(_WARNINGS))


def board(rng: Rng, text: str, shape: tuple[int, int], texel_m: float) -> Array32:
    """A board (h, w, 3) in linear light with a line of text, a border or a device, and years of weather."""
    h, w = shape
    back = np.array(_BOARDS[rng.integers(len(_BOARDS))]) * rng.uniform(0.8, 1.1)
    ink = np.array([0.5, 0.5, 0.48]) if back.mean() < 0.2 else np.array(_BOARDS[rng.integers(1, 5)])
    albedo = np.empty((h, w, 3), np.float32)
    albedo[:] = back
    left = 0
    if w > 2.5 * h and rng.random() < 0.6:
        left = h
        _device(albedo[:, :h], rng, ink)
    blend(albedo[:, left:], written(rng, text, (h, w - left)), ink)
    if rng.random() < 0.5:
        edge = max(1, h // 24)
        cv2.rectangle(albedo, (edge, edge), (w - 1 - edge, h - 1 - edge), ink.tolist(), edge)
    fade = np.clip(0.35 + 0.3 * noise(rng, shape, texel_m, 1.0), 0, 0.5)
    blend(albedo, fade * np.float32(0.35), (0.30, 0.29, 0.27))
    albedo *= (1 + octaves(rng, shape, texel_m, 0.03, largest_m=1.0))[..., None]
    return np.clip(albedo, 0.02, 0.7)


def written(rng: Rng, text: str, shape: tuple[int, int]) -> Array32:
    """Cover (h, w) in [0, 1] of a line of text as large as fits."""
    mask: NDArray[np.uint8] = np.zeros(shape, np.uint8)
    font, thick = int(rng.choice(_FONTS)), max(1, round(shape[0] / 16))
    (wide, tall), _ = cv2.getTextSize(text, font, 1.0, 1)
    scale = min(0.82 * shape[1] / wide, 0.52 * shape[0] / tall)
    place = (int((shape[1] - scale * wide) / 2), int((shape[0] + scale * tall) / 2))
    cv2.putText(mask, text, place, font, scale, 255, min(thick, max(1, round(scale * 3))), cv2.LINE_AA)
    return mask.astype(np.float32) / np.float32(255)


def _device(albedo: Array32, rng: Rng, ink: Array) -> None:
    n = albedo.shape[0]
    colour = (ink * rng.uniform(0.6, 1.0, 3)).tolist()
    kind = rng.integers(3)
    if kind == 0:
        cv2.circle(albedo, (n // 2, n // 2), int(0.3 * n), colour, -1, cv2.LINE_AA)
    elif kind == 1:
        turn = rng.uniform(0, 6) + np.arange(int(rng.integers(3, 7))) * 2.4
        star = n / 2 + 0.34 * n * np.column_stack([np.cos(turn), np.sin(turn)])
        cv2.fillPoly(albedo, [star.astype(np.int32)], colour, cv2.LINE_AA)
    else:
        cv2.rectangle(albedo, (n // 4, n // 4), (3 * n // 4, n // 2), colour, -1)
        cv2.rectangle(albedo, (n // 3, n // 2), (2 * n // 3, 3 * n // 4), (ink * 0.6).tolist(), -1)


def poster(rng: Rng, shape: tuple[int, int], texel_m: float) -> Array32:
    """A bill (h, w, 3): a ground, a few large shapes, lines of text; paper that has hung in the rain."""
    h, w = shape
    albedo = np.empty((h, w, 3), np.float32)
    albedo[:] = rng.uniform(0.12, 0.5) * rng.uniform(0.75, 1.15, 3)
    for _ in range(rng.integers(1, 5)):
        colour = (rng.uniform(0.05, 0.45) * rng.uniform(0.6, 1.3, 3)).tolist()
        place = (int(rng.uniform(0, w)), int(rng.uniform(0, h)))
        if rng.random() < 0.5:
            cv2.circle(albedo, place, int(w * rng.uniform(0.1, 0.45)), colour, -1, cv2.LINE_AA)
        else:
            other = (int(rng.uniform(0, w)), int(rng.uniform(0, h)))
            cv2.rectangle(albedo, place, other, colour, -1)
    line = max(6, h // 7)
    ink = 0.03 * np.ones(3) if albedo.mean() > 0.18 else 0.5 * np.ones(3)
    for top in rng.choice(np.arange(0, h - line, line), min(3, max(1, (h - line) // line)), replace=False):
        blend(albedo[top : top + line], written(rng, firm(rng), (line, w)), ink)
    albedo *= (1 + octaves(rng, shape, texel_m, 0.04, largest_m=0.5))[..., None]
    return np.clip(albedo, 0.02, 0.6)
