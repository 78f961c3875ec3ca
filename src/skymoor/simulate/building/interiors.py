# SPDX-License-Identifier: Apache-2.0
"""What is seen through glass: dim painted rooms on one page, a tile for each."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from skymoor.simulate.building.materials import Array32, Rng, noise
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.mesh import Array

TILE_M = 2.4
_TEXEL_M = 0.03
_ACROSS, _DOWN = 6, 4


@dataclass(frozen=True)
class Rooms:
    """A page of rooms, side by side."""

    page: int

    def uv(self, rng: Rng, rects: ArrayLike) -> Array:
        """Texture coordinates (n, 4, 2) for panes (n, 4) x0, z0, x1, z1: each shows a piece of a room of its own.

        Panes that touch show the same room, each its part of it; every second room is seen the other way round.
        """
        r = np.asarray(rects, np.float64).reshape(-1, 4)
        n = len(r)
        tile = rng.integers(0, _ACROSS * _DOWN, n)
        size = np.minimum(np.stack([r[:, 2] - r[:, 0], r[:, 3] - r[:, 1]], axis=1), TILE_M - 0.1)
        start = 0.05 + rng.random((n, 2)) * (TILE_M - 0.1 - size) * [1.0, 0.4]
        corner = np.stack([tile % _ACROSS, tile // _ACROSS], axis=1) * TILE_M + start
        left, right = corner[:, 0], corner[:, 0] + size[:, 0]
        flip = rng.random(n) < 0.5
        left, right = np.where(flip, right, left), np.where(flip, left, right)
        top, bottom = corner[:, 1], corner[:, 1] + size[:, 1]
        corners = [[left, bottom], [right, bottom], [right, top], [left, top]]
        uv: Array = np.stack([np.stack(corner, axis=1) for corner in corners], axis=1)
        return uv


def paint_rooms(rng: Rng, pages: Pages) -> Rooms:
    """Paint the rooms of a building, darker where nobody is in."""
    n = round(TILE_M / _TEXEL_M)
    rows = [np.concatenate([_room(rng, n) for _ in range(_ACROSS)], axis=1) for _ in range(_DOWN)]
    return Rooms(pages.add(np.concatenate(rows, axis=0), _TEXEL_M))


def _room(rng: Rng, n: int) -> Array32:
    """A room (n, n, 3) seen from outside: ceiling, back wall, floor, lamps, things on the floor."""
    light = np.float32(rng.choice([0.35, 0.7, 1.0, 1.5]))
    paint = np.array(rng.uniform(0.05, 0.09) * rng.uniform(0.92, 1.06, 3) * [1.1, 1.0, 0.9], np.float32) * light
    room = np.empty((n, n, 3), np.float32)
    room[:] = paint * 0.8
    top, bottom, left, right = (
        int(n * rng.uniform(*span)) for span in ((0.2, 0.32), (0.68, 0.8), (0.1, 0.25), (0.75, 0.95))
    )
    corners = {
        1.7: [(0, 0), (n, 0), (right, top), (left, top)],
        0.45: [(0, n), (n, n), (right, bottom), (left, bottom)],
        1.0: [(left, top), (right, top), (right, bottom), (left, bottom)],
    }
    for shade, corner in corners.items():
        cv2.fillConvexPoly(room, np.array(corner, np.int32), (paint * np.float32(shade)).tolist(), cv2.LINE_AA)
    _lamps(room, rng, top, float(light))
    for _ in range(rng.integers(2, 7)):
        _thing(room, rng, bottom)
    if rng.random() < 0.35:
        _curtains(room, rng)
    room *= (1 + 0.12 * noise(rng, (n, n), _TEXEL_M, 0.5))[..., None]
    return np.asarray(np.clip(cv2.GaussianBlur(room, (0, 0), 0.7), 0.012, 0.3), np.float32)


def _lamps(room: Array32, rng: Rng, top: int, light: float) -> None:
    n = len(room)
    glow = 0.28 if light > 0.6 else 0.05 * light
    for row in np.linspace(0.25, 0.85, int(rng.integers(1, 4))) * top:
        half = 0.5 * n * (1 - 0.75 * row / n)
        for x in np.linspace(-0.7, 0.7, int(rng.integers(2, 4))) * half + n / 2:
            cv2.rectangle(
                room, (int(x - 0.07 * n), int(row)), (int(x + 0.07 * n), int(row + 2)), (glow, glow, 0.95 * glow), -1
            )


def _thing(room: Array32, rng: Rng, bottom: int) -> None:
    """A shelf, a desk with a screen, a plant: dark or light silhouettes that stand on the floor or at the window."""
    n = len(room)
    tone = (rng.uniform(0.012, 0.10) * rng.uniform(0.85, 1.15, 3)).tolist()
    x, wide, tall = int(rng.uniform(0, n)), int(n * rng.uniform(0.08, 0.3)), int(n * rng.uniform(0.12, 0.45))
    foot = int(rng.uniform(bottom, 1.05 * n))
    cv2.rectangle(room, (x, foot - tall), (x + wide, foot), tone, -1)
    if rng.random() < 0.4:
        screen = (rng.uniform(0.02, 0.2) * np.array([0.8, 1.0, 1.15])).tolist()
        cv2.rectangle(room, (x + wide // 4, foot - tall - n // 9), (x + wide, foot - tall - 2), screen, -1)
    elif rng.random() < 0.4:
        leaf = (rng.uniform(0.02, 0.04), rng.uniform(0.03, 0.06), 0.02)
        cv2.ellipse(room, (x + wide // 2, foot - tall), (n // 10, n // 8), 0, 0, 360, leaf, -1, cv2.LINE_AA)


def _curtains(room: Array32, rng: Rng) -> None:
    n = len(room)
    wide = int(n * rng.uniform(0.08, 0.3))
    folds = (
        (0.16 + 0.05 * np.sin(np.arange(wide) * rng.uniform(0.8, 1.6)))[None, :, None]
        * rng.uniform(0.5, 1.1)
        * rng.uniform(0.9, 1.1, 3)
    )
    room[:, :wide] = folds
    room[:, n - wide :] = folds[:, ::-1]
