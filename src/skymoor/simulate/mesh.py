# SPDX-License-Identifier: Apache-2.0
"""Triangles that know their looks: what every simulated thing is made of.

A part is a soup of triangles, without shared vertices: a thing is made by listing its faces, and joining is stacking.
Texture coordinates are metres on a page (see `light.pages`), u to the right and v down from the page's top left corner.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]


class Label(IntEnum):
    """What a surface is; glass and water also reflect."""

    SKY = 0
    GROUND = 1
    PAVED = 2
    WATER = 3
    WALL = 4
    ROOF = 5
    GLASS = 6
    PLANT = 7
    CAR = 8
    OBJECT = 9


GROUND_LABELS = (Label.GROUND, Label.PAVED, Label.WATER)


@dataclass(frozen=True, eq=False)
class Part:
    """n triangles: corners (n, 3, 3) ENU metres, uv (n, 3, 2) metres, and per triangle page, label and tint (n, 3)."""

    corners: Array32
    uv: Array32
    page: NDArray[np.int16]
    label: NDArray[np.uint8]
    tint: Array32

    def __len__(self) -> int:
        return len(self.corners)

    def placed(self, heading_deg: float, origin: ArrayLike) -> Part:
        """Turned counter-clockwise from above about the up axis, then moved by `origin` (3,)."""
        c, s = np.cos(np.radians(heading_deg)), np.sin(np.radians(heading_deg))
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        return replace(self, corners=(self.corners @ turn + np.asarray(origin)).astype(np.float32))


def triangles(corners: ArrayLike, uv: ArrayLike, page: int, label: Label, tint: ArrayLike = (1.0, 1.0, 1.0)) -> Part:
    """Triangles (n, 3, 3) with texture coordinates (n, 3, 2); `tint` (3,) or (n, 3) multiplies the page's colours."""
    points = np.asarray(corners, dtype=np.float32).reshape(-1, 3, 3)
    n = len(points)
    return Part(
        points,
        np.asarray(uv, dtype=np.float32).reshape(n, 3, 2),
        np.full(n, page, dtype=np.int16),
        np.full(n, label, dtype=np.uint8),
        np.broadcast_to(np.asarray(tint, dtype=np.float32), (n, 3)),
    )


def quads(corners: ArrayLike, uv: ArrayLike, page: int, label: Label, tint: ArrayLike = (1.0, 1.0, 1.0)) -> Part:
    """Flat four-cornered faces (n, 4, 3), in order round the face, with uv (n, 4, 2); `tint` (3,) or (n, 3)."""
    points, texture = np.asarray(corners).reshape(-1, 4, 3), np.asarray(uv).reshape(-1, 4, 2)
    order = [0, 1, 2, 0, 2, 3]
    colours = np.repeat(np.broadcast_to(np.asarray(tint, np.float32), (len(points), 3)), 2, axis=0)
    return triangles(points[:, order], texture[:, order], page, label, colours)


def parallelograms(
    origins: ArrayLike, along: ArrayLike, up: ArrayLike, page: int, label: Label, tint: ArrayLike = (1.0, 1.0, 1.0)
) -> Part:
    """Faces from their lower left corners (n, 3) and two edges (n, 3); textured in metres from their upper left."""
    a, u = np.broadcast_arrays(np.asarray(along, np.float64), np.asarray(up, np.float64))
    o, a, u = (np.reshape(x, (-1, 3)) for x in np.broadcast_arrays(np.asarray(origins, np.float64), a, u))
    width, height = np.linalg.norm(a, axis=1), np.linalg.norm(u, axis=1)
    zero = np.zeros_like(width)
    uv = np.stack([[zero, height], [width, height], [width, zero], [zero, zero]], axis=0).transpose(2, 0, 1)
    return quads(np.stack([o, o + a, o + a + u, o + u], axis=1), uv, page, label, tint)


def cuboid(
    origin: ArrayLike, edges: ArrayLike, page: int, label: Label, tint: ArrayLike = (1.0, 1.0, 1.0), *, sides: int = 6
) -> Part:
    """A block with a corner at `origin` (3,) and three edges, rows of (3, 3); the third is upwards.

    `sides` 5 leaves out the bottom, 4 also the top.
    """
    o, (a, b, c) = np.asarray(origin, np.float64), np.asarray(edges, np.float64)
    faces = [(o, a, c), (o + a, b, c), (o + a + b, -a, c), (o + b, -b, c), (o + c, a, b), (o + b, a, -b)][:sides]
    first, along, up = (np.array([face[k] for face in faces]) for k in range(3))
    return parallelograms(first, along, up, page, label, tint)


def cylinder(
    base: ArrayLike,
    radius: float,
    height: float,
    page: int,
    label: Label,
    tint: ArrayLike = (1.0, 1.0, 1.0),
    *,
    facets: int = 16,
    top_radius: float | None = None,
    cap: Label | None = None,
) -> Part:
    """An upright cylinder or cone on the centre `base` (3,) of its foot; with a `cap` label it is closed at the top."""
    turn = np.linspace(0, 2 * np.pi, facets + 1)
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(facets + 1)])
    foot = np.asarray(base, np.float64) + radius * ring
    head = np.asarray(base, np.float64) + (radius if top_radius is None else top_radius) * ring + [0, 0, height]
    u = radius * turn
    uv = np.stack(
        [np.stack([u[:-1], u[:-1] * 0 + height], 1), np.stack([u[1:], u[1:] * 0 + height], 1)]
        + [np.stack([u[1:], u[1:] * 0], 1), np.stack([u[:-1], u[:-1] * 0], 1)],
        axis=1,
    )
    wall = quads(np.stack([foot[:-1], foot[1:], head[1:], head[:-1]], axis=1), uv, page, label, tint)
    if cap is None:
        return wall
    middle = np.broadcast_to(np.asarray(base, np.float64) + [0, 0, height], head[:-1].shape)
    disc = np.stack([middle, head[:-1], head[1:]], axis=1)
    return join([wall, triangles(disc, disc[..., :2] - disc[..., :2].min(axis=(0, 1)), page, cap, tint)])


def join(parts: Iterable[Part]) -> Part:
    """All triangles of the parts."""
    every = list(parts)
    if not every:
        return triangles(np.zeros((0, 3, 3)), np.zeros((0, 3, 2)), 0, Label.OBJECT)
    names = ("corners", "uv", "page", "label", "tint")
    return Part(*(np.concatenate([getattr(part, name) for part in every]) for name in names))


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """Random numbers of one thing: another thing drawn before it, or left out, changes nothing in them."""
    keys = [zlib.crc32(name.encode()) if isinstance(name, str) else name for name in names]
    return np.random.default_rng([seed, *keys])


def rectangles_of(outline: ArrayLike) -> Array:
    """Cells (n, 4) x0, y0, x1, y1 that fill a rectilinear outline (k, 2) given counter-clockwise."""
    points = np.asarray(outline, np.float64)
    xs, ys = np.unique(points[:, 0]), np.unique(points[:, 1])
    cells = [
        (x0, y0, x1, y1)
        for x0, x1 in pairwise(xs)
        for y0, y1 in pairwise(ys)
        if inside(points, np.array([[(x0 + x1) / 2, (y0 + y1) / 2]]))[0]
    ]
    return np.array(cells)


def inside(outline: ArrayLike, plan: ArrayLike) -> NDArray[np.bool_]:
    """Whether plan positions (n, 2) lie in a polygon (k, 2): crossings of a ray to the east."""
    polygon, points = np.asarray(outline, np.float64), np.asarray(plan, np.float64).reshape(-1, 2)
    odd = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        spans = (y0 > points[:, 1]) != (y1 > points[:, 1])
        if y0 != y1:
            odd ^= spans & (points[:, 0] < x0 + (points[:, 1] - y0) * (x1 - x0) / (y1 - y0))
    return odd


def rectangle(length: float, width: float) -> Sequence[tuple[float, float]]:
    """The outline of a rectangle about the origin, counter-clockwise."""
    a, b = length / 2, width / 2
    return ((-a, -b), (a, -b), (a, b), (-a, b))
