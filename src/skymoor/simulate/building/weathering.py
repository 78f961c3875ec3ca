# SPDX-License-Identifier: Apache-2.0
"""What years do to a painted wall: streaks, dirt, cracks, repairs, and the mark that a flood leaves.

All functions paint in place on a picture (h, w, 3) of a wall, in linear light, whose row 0 is `top_m` over the ground.
Rectangles are (n, 4) x0, z0, x1, z1 in metres along the wall and over the ground.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.simulate.building.materials import Array32, Rng, blend, centres, noise
from skymoor.simulate.mesh import Array


def age(albedo: Array32, rng: Rng, texel_m: float, top_m: float, openings: Array, strength: float) -> None:
    """Everything but floods, in the order in which it happens: repairs, cracks, streaks, dirt."""
    repairs(albedo, rng, texel_m, strength)
    cracks(albedo, rng, texel_m, strength)
    runoff(albedo, rng, texel_m, strength)
    sill_streaks(albedo, rng, texel_m, top_m, openings, strength)
    rust_streaks(albedo, rng, texel_m, strength)
    splash(albedo, rng, texel_m, top_m, strength)


def repairs(albedo: Array32, rng: Rng, texel_m: float, strength: float) -> None:
    """Patches of newer or older material with soft, uneven borders, about one on 25 square metres."""
    h, w = albedo.shape[:2]
    for _ in range(rng.poisson(strength * h * w * texel_m**2 / 25)):
        tall, wide = (int(size / texel_m) for size in rng.uniform((0.3, 0.3), (1.8, 2.4)))
        y, x = int(rng.uniform(0, h)), int(rng.uniform(0, w))
        tone = rng.normal(0, 0.14) + rng.normal(0, 0.03, 3)
        piece = albedo[y : y + tall, x : x + wide]
        ys, xs = centres((piece.shape[0], piece.shape[1]), texel_m)
        border = np.minimum(np.minimum(ys, tall * texel_m - ys), np.minimum(xs, wide * texel_m - xs))
        rough = np.float32(rng.choice([0.01, 0.06])) * noise(rng, (piece.shape[0], piece.shape[1]), texel_m, 0.15)
        cover = np.clip((border + rough) / 0.03, 0, 1)
        piece *= 1 + cover[..., None] * tone.astype(np.float32)


def cracks(albedo: Array32, rng: Rng, texel_m: float, strength: float) -> None:
    """Thin dark lines that wander; some were filled and are light."""
    h, w = albedo.shape[:2]
    mask = np.zeros((h, w), np.uint8)
    for _ in range(rng.poisson(strength * h * w * texel_m**2 / 40)):
        steps = rng.normal(0, 0.09, (rng.integers(6, 22), 2)) + rng.choice([[0.1, 0.02], [0.02, 0.1]])
        line = (rng.uniform(0, 1, 2) * [w, h] + np.cumsum(steps, axis=0) / texel_m) * 16
        cv2.polylines(mask, [line.astype(np.int32)], False, int(rng.integers(90, 230)), 1, cv2.LINE_AA, 4)  # noqa: FBT003
    albedo *= 1 - np.float32(0.5 / 255) * mask[..., None]


def runoff(albedo: Array32, rng: Rng, texel_m: float, strength: float) -> None:
    """Dark streaks of rain from the top edge, each as long as it likes."""
    h, w = albedo.shape[:2]
    y, _ = centres((h, w), texel_m)
    reach = np.clip(0.9 * np.exp(0.9 * noise(rng, (1, w), texel_m, (1.0, 0.09))[:1]), 0.05, 8.0)
    heavy = np.clip(0.5 + 0.6 * noise(rng, (1, w), texel_m, (1.0, 1.1))[:1], 0, 1.6)
    fade = np.exp(-y / reach) * heavy * np.float32(0.32 * strength)
    albedo *= (1 - np.clip(fade, 0, 0.7))[..., None]


def sill_streaks(albedo: Array32, rng: Rng, texel_m: float, top_m: float, openings: Array, strength: float) -> None:
    """Dirt washed down below each opening, most at the ends of its sill."""
    h, w = albedo.shape[:2]
    for x0, z0, x1, _ in openings:
        left, right = max(int((x0 - 0.1) / texel_m), 0), min(int((x1 + 0.1) / texel_m), w)
        start = int((top_m - z0) / texel_m)
        if start >= h or right - left < 4:
            continue
        reach = rng.uniform(0.3, 1.3)
        piece = albedo[start : min(start + int(2.2 * reach / texel_m), h), left:right]
        y, x = centres((piece.shape[0], piece.shape[1]), texel_m)
        ends = 0.35 + 0.65 * np.exp(-np.minimum(x, (right - left) * texel_m - x) / 0.12)
        streak = np.clip(0.6 + 0.7 * noise(rng, (1, right - left), texel_m, (1.0, 0.05)), 0, 2)
        piece *= (1 - np.clip(0.3 * strength * rng.uniform(0.3, 1.3) * ends * streak * np.exp(-y / reach), 0, 0.6))[
            ..., None
        ]


def rust_streaks(albedo: Array32, rng: Rng, texel_m: float, strength: float) -> None:
    """Brown lines below forgotten hooks and screws."""
    h, w = albedo.shape[:2]
    for _ in range(rng.poisson(strength * h * w * texel_m**2 / 35)):
        y0, x0 = int(rng.uniform(0, h)), int(rng.uniform(0, w))
        long, half = int(rng.uniform(0.2, 1.2) / texel_m), max(1, int(rng.uniform(0.015, 0.05) / texel_m))
        piece = albedo[y0 : y0 + long, max(x0 - 2 * half, 0) : x0 + 2 * half + 1]
        ys, xs = centres((piece.shape[0], piece.shape[1]), texel_m)
        middle = (min(x0, 2 * half) + 0.5) * texel_m
        cover = np.exp(-ys / (0.5 * long * texel_m) - ((xs - middle) / (half * texel_m)) ** 2)
        blend(piece, 0.55 * cover, (0.17, 0.085, 0.045))


def splash(albedo: Array32, rng: Rng, texel_m: float, top_m: float, strength: float) -> None:
    """Mud and moss near the ground, with an uneven upper edge."""
    h, w = albedo.shape[:2]
    y, _ = centres((h, w), texel_m)
    height = (
        0.38 + 0.2 * noise(rng, (1, w), texel_m, (1.0, 0.7))[:1] + 0.05 * noise(rng, (1, w), texel_m, (1.0, 0.1))[:1]
    )
    first = max(int((top_m - 1.6) / texel_m), 0)
    level = np.clip(1.0 - (top_m - y[first:]) / np.maximum(2.2 * height, 0.15), 0, 1) ** 1.5
    patchy = np.clip(0.75 + 0.3 * noise(rng, (h - first, w), texel_m, 0.3), 0, 1)
    blend(albedo[first:], 0.62 * strength * level * patchy, (0.13, 0.115, 0.085))


def tide_mark(albedo: Array32, rng: Rng, texel_m: float, top_m: float, water_m: float) -> None:
    """Silt up to where the water once stood, a dark line there, and a wet band just over the water of today.

    `water_m` is the water's level over the ground floor.
    """
    h, w = albedo.shape[:2]
    y, _ = centres((h, w), texel_m)
    over = top_m - y - water_m
    crest = np.float32(rng.uniform(0.55, 0.95)) + 0.03 * noise(rng, (1, w), texel_m, (1.0, 0.5))[:1]
    below = np.clip((crest - over) / 0.04, 0, 1)
    patchy = np.clip(0.55 + 0.2 * noise(rng, (h, w), texel_m, (0.25, 0.9)), 0.1, 0.85)
    blend(albedo, below * patchy, (0.17, 0.14, 0.095))
    line = np.exp(-(((over - crest) / 0.035) ** 2)) + 0.6 * np.exp(-(((over - 0.6 * crest) / 0.02) ** 2))
    wet = np.clip(1 - over / (0.12 + 0.04 * noise(rng, (1, w), texel_m, (1.0, 0.3))[:1]), 0, 1)
    albedo *= (1 - np.clip(0.45 * line + 0.55 * wet, 0, 0.8)).astype(np.float32)[..., None]


def spots(shape: tuple[int, int], rng: Rng, texel_m: float, per_m2: float, radius_m: tuple[float, float]) -> Array32:
    """Cover (h, w) in [0, 1] of round stains."""
    mask: NDArray[np.uint8] = np.zeros(shape, np.uint8)
    for _ in range(rng.poisson(per_m2 * shape[0] * shape[1] * texel_m**2)):
        place = (int(rng.uniform(0, shape[1])), int(rng.uniform(0, shape[0])))
        radius = max(1, int(rng.uniform(*radius_m) / texel_m))
        axes = (radius, max(1, int(radius * rng.uniform(0.4, 1.0))))
        cv2.ellipse(mask, place, axes, rng.uniform(0, 180), 0, 360, int(rng.integers(60, 255)), -1, cv2.LINE_AA)
    soft = cv2.GaussianBlur(mask, (0, 0), max(0.6, 0.25 * radius_m[0] / texel_m))
    return np.asarray(soft / 255, np.float32)
