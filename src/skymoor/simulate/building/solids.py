# SPDX-License-Identifier: Apache-2.0
"""Many blocks and bars at once: what the fittings of buildings are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from skymoor.simulate.mesh import Array, Label, Part, join, parallelograms

ALL = ("-y", "+x", "+y", "-x", "+z", "-z")
ON_WALL = ("-y", "+x", "-x", "+z", "-z")
ON_FLOOR = ("-y", "+x", "+y", "-x", "+z")


def boxes(
    low: ArrayLike,
    high: ArrayLike,
    page: int,
    label: Label,
    tint: ArrayLike = (1.0, 1.0, 1.0),
    *,
    faces: tuple[str, ...] = ALL,
) -> Part:
    """Upright blocks between corners `low` and `high` (n, 3), with a tint (3,) or (n, 3), and only the faces named.

    The texture of each block starts elsewhere on the page, so that equal blocks do not look the same.
    """
    a, b = np.broadcast_arrays(np.asarray(low, np.float64).reshape(-1, 3), np.asarray(high, np.float64).reshape(-1, 3))
    x, y, z = (np.where(np.arange(3) == axis, b - a, 0.0) for axis in range(3))
    sides = {
        "-y": (a, x, z),
        "+x": (a + x, y, z),
        "+y": (a + x + y, -x, z),
        "-x": (a + y, -y, z),
        "+z": (a + z, x, y),
        "-z": (a + y, x, -y),
    }
    colours = np.broadcast_to(np.asarray(tint, np.float64), a.shape)
    part = join(parallelograms(*sides[face], page, label, colours) for face in faces)
    start = np.tile(np.repeat(a @ [[0.73, 0.31], [0.57, 0.83], [0.37, 0.61]], 2, axis=0), (len(faces), 1))
    return replace(part, uv=(part.uv + start[:, None, :]).astype(np.float32))


def on_wall(
    rects: ArrayLike, out_m: ArrayLike, page: int, label: Label, tint: ArrayLike = (1.0, 1.0, 1.0), *, in_m: float = 0.0
) -> Part:
    """Blocks on a wall (x along it, y into the building): rectangles (n, 4) x0, z0, x1, z1 that stand `out_m` proud.

    `in_m` is how far they reach behind the wall's face; a negative `out_m` sets them back into an opening.
    """
    r = np.asarray(rects, np.float64).reshape(-1, 4)
    front = np.broadcast_to(-np.asarray(out_m, np.float64), len(r))
    low = np.column_stack([r[:, 0], front, r[:, 1]])
    high = np.column_stack([r[:, 2], np.full(len(r), in_m), r[:, 3]])
    return boxes(low, high, page, label, tint, faces=ON_WALL)


def bars(starts: ArrayLike, ends: ArrayLike, thick_m: float, page: int, label: Label, tint: ArrayLike) -> Part:
    """Square bars between points (n, 3), for railings and stairs: four sides each, no ends."""
    a, b = np.asarray(starts, np.float64).reshape(-1, 3), np.asarray(ends, np.float64).reshape(-1, 3)
    along = b - a
    length = np.linalg.norm(along, axis=1, keepdims=True)
    unit = along / np.maximum(length, 1e-9)
    other = np.where(np.abs(unit[:, 2:]) > 0.9, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    right = _unit(np.cross(unit, other)) * thick_m
    up = np.cross(right, unit)
    corner = a - (right + up) / 2
    colours = np.broadcast_to(np.asarray(tint, np.float64), a.shape)
    sides = [(corner, up), (corner + up, right), (corner + up + right, -up), (corner + right, -right)]
    return join(parallelograms(origin, along, side, page, label, colours) for origin, side in sides)


def _unit(vectors: Array) -> Array:
    scaled: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return scaled


def solid(part: Part) -> Part:
    """The part without triangles of no area."""
    edge = part.corners[:, 1:] - part.corners[:, :1]
    keep = np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1) > 1e-7
    return Part(part.corners[keep], part.uv[keep], part.page[keep], part.label[keep], part.tint[keep])
