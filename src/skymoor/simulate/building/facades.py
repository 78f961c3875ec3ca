# SPDX-License-Identifier: Apache-2.0
"""Walls as triangles: the face with its holes, reveals, windows with frames and sills, doors and gates.

Everything is in the wall's own frame, see `openings`; a building puts its walls where they belong.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skymoor.simulate.building.kit import BELOW_M, Kit
from skymoor.simulate.building.materials import Rng
from skymoor.simulate.building.openings import Opening, Style, rects
from skymoor.simulate.building.solids import boxes, on_wall
from skymoor.simulate.mesh import Array, Label, Part, join, quads
from skymoor.simulate.plan import Building

FOOT_M = -2.5
"""How deep walls go: the ground slopes."""


@dataclass(frozen=True)
class Face:
    """A wall to be built: its length, its page, the height of the page's top, and the height of the upright wall."""

    length_m: float
    page: int
    page_top_m: float
    wall_top_m: float


def cells_without(holes: Array, bounds: tuple[float, float, float, float]) -> Array:
    """Rectangles (n, 4) x0, z0, x1, z1 that fill `bounds` but for the holes (k, 4), in rows as wide as can be."""
    xs = np.unique(np.clip(np.concatenate([holes[:, [0, 2]].ravel(), bounds[::2]]), bounds[0], bounds[2]))
    zs = np.unique(np.clip(np.concatenate([holes[:, [1, 3]].ravel(), bounds[1::2]]), bounds[1], bounds[3]))
    x, z = (xs[:-1] + xs[1:]) / 2, (zs[:-1] + zs[1:]) / 2
    over_x = (holes[:, 0, None] < x) & (x < holes[:, 2, None])
    over_z = (holes[:, 1, None] < z) & (z < holes[:, 3, None])
    full = ~(over_z[:, :, None] & over_x[:, None, :]).any(axis=0)
    edge = np.diff(np.pad(full, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (row, start), (_, end) = np.nonzero(edge == 1), np.nonzero(edge == -1)
    return np.column_stack([xs[start], zs[row], xs[end], zs[row + 1]])


def wall_face(face: Face, openings: tuple[Opening, ...], profile: ArrayLike) -> Part:
    """The wall with its holes, its continuation under the ground, what rises above it, and the reveals.

    `profile` (k, 2) is x, z along the top of the wall, from its left end to its right one.
    """
    cells = cells_without(rects(openings), (0.0, -BELOW_M, face.length_m, face.wall_top_m))
    x0, z0, x1, z1 = cells.T
    corners = np.stack([_xz(x0, z0), _xz(x1, z0), _xz(x1, z1), _xz(x0, z1)], axis=1)
    line = np.asarray(profile, np.float64)
    a, b, foot = line[:-1], line[1:], np.full(len(line) - 1, face.wall_top_m)
    crown = np.stack([_xz(a[:, 0], foot), _xz(b[:, 0], foot), _xz(b[:, 0], b[:, 1]), _xz(a[:, 0], a[:, 1])], axis=1)
    buried = _xz([0, face.length_m, face.length_m, 0], [FOOT_M, FOOT_M, -BELOW_M, -BELOW_M])[None]
    every = np.concatenate([corners, crown, buried])
    z = np.maximum(every[..., 2], -BELOW_M + 0.01)
    uv = np.stack([every[..., 0], face.page_top_m - z], axis=-1)
    return join([quads(every, uv, face.page, Label.WALL), reveals(face, openings)])


def reveals(face: Face, openings: tuple[Opening, ...]) -> Part:
    """The four sides of each hole; the wall's texture goes on round the corner."""
    x0, z0, x1, z1 = rects(openings).T
    deep = np.array([opening.recess_m for opening in openings])
    zero, top = np.zeros_like(deep), face.page_top_m
    left = [_xz(x0, z0), _xz(x0, z0, deep), _xz(x0, z1, deep), _xz(x0, z1)]
    right = [_xz(x1, z0, deep), _xz(x1, z0), _xz(x1, z1), _xz(x1, z1, deep)]
    head = [_xz(x0, z1, deep), _xz(x1, z1, deep), _xz(x1, z1), _xz(x0, z1)]
    foot = [_xz(x0, z0), _xz(x1, z0), _xz(x1, z0, deep), _xz(x0, z0, deep)]
    uv = [
        [(x0, top - z0), (x0 - deep, top - z0), (x0 - deep, top - z1), (x0, top - z1)],
        [(x1 + deep, top - z0), (x1, top - z0), (x1, top - z1), (x1 + deep, top - z1)],
        [(x0, top - z1 - deep), (x1, top - z1 - deep), (x1, top - z1 + zero), (x0, top - z1)],
        [(x0, top - z0), (x1, top - z0), (x1, top - z0 + deep), (x0, top - z0 + deep)],
    ]
    corners = np.concatenate([np.stack(side, axis=1) for side in (left, right, head, foot)])
    texture = np.concatenate([np.stack([np.stack(corner, axis=1) for corner in side], axis=1) for side in uv])
    return quads(corners, texture, face.page, Label.WALL, (0.92, 0.92, 0.92))


def _xz(x: ArrayLike, z: ArrayLike, y: ArrayLike = 0.0) -> Array:
    return np.stack(np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float), np.asarray(z, float)), axis=-1)


def glazing(kit: Kit, rng: Rng, rect: ArrayLike, depth_m: float, columns: int, broken: float = 0.0) -> Part:
    """Panes of windows (n, 4), `depth_m` behind the wall's face; a share of them is `broken`, and dark inside."""
    r = np.asarray(rect, np.float64).reshape(-1, 4)
    uv = kit.rooms.uv(rng, r)
    split = np.arange(columns + 1) / columns
    x = r[:, :1] + (r[:, 2:3] - r[:, :1]) * split
    u = uv[:, :1, 0] + (uv[:, 1:2, 0] - uv[:, :1, 0]) * split
    left, right = x[:, :-1].ravel(), x[:, 1:].ravel()
    bottom, top = np.repeat(r[:, 1], columns), np.repeat(r[:, 3], columns)
    low, high = np.repeat(uv[:, 0, 1], columns), np.repeat(uv[:, 2, 1], columns)
    texture = np.stack(
        [
            np.stack([u[:, :-1].ravel(), low], 1),
            np.stack([u[:, 1:].ravel(), low], 1),
            np.stack([u[:, 1:].ravel(), high], 1),
            np.stack([u[:, :-1].ravel(), high], 1),
        ],
        axis=1,
    )
    hole = rng.random(len(left)) < broken
    y = np.where(hole, depth_m + 0.25, depth_m)
    corners = np.stack([_xz(left, bottom, y), _xz(right, bottom, y), _xz(right, top, y), _xz(left, top, y)], axis=1)
    dim = np.repeat(rng.uniform(0.75, 1.1, len(r)), columns)[:, None] * np.ones(3)
    whole = quads(corners[~hole], texture[~hole], kit.rooms.page, Label.GLASS, dim[~hole])
    return join([whole, quads(corners[hole], texture[hole], kit.rooms.page, Label.WALL, 0.3 * dim[hole])])


def frames(kit: Kit, rect: ArrayLike, style: Style, depth_m: float, *, proud_m: float = 0.045) -> Part:
    """Frames, mullions and a transom that stand `proud_m` before the glass of windows (n, 4)."""
    x0, z0, x1, z1 = np.asarray(rect, np.float64).reshape(-1, 4).T
    f, front = style.frame_m, depth_m - proud_m

    def bar(a: Array, b: Array, c: Array, d: Array, faces: tuple[str, ...]) -> Part:
        low, high = _xz(a, b, front), _xz(c, d, depth_m)
        return boxes(low, high, kit.grain, Label.OBJECT, style.tint, faces=("-y", *faces))

    middles = [x0 + (x1 - x0) * k / style.columns for k in range(1, style.columns)]
    parts = [
        bar(x0, z0, x0 + f, z1, ("+x",)),
        bar(x1 - f, z0, x1, z1, ("-x",)),
        bar(x0, z0, x1, z0 + f, ("+z",)),
        bar(x0, z1 - f, x1, z1, ("-z",)),
        *(bar(x - 0.45 * f, z0, x + 0.45 * f, z1, ("-x", "+x")) for x in middles),
    ]
    if style.transom > 0:
        z = z1 - style.transom * (z1 - z0)
        parts.append(bar(x0, z - 0.4 * f, x1, z + 0.4 * f, ("-z", "+z")))
    return join(parts)


def sills_and_heads(kit: Kit, rect: ArrayLike, style: Style, rng: Rng) -> Part:
    """A sill that stands out under each window of (n, 4), and what its style has above or round it."""
    x0, z0, x1, z1 = np.asarray(rect, np.float64).reshape(-1, 4).T
    tint = kit.stone * rng.uniform(0.88, 1.08, (len(x0), 1))
    sill = np.column_stack([x0 - 0.07, z0 - 0.07, x1 + 0.07, z0 + 0.005])
    parts = [on_wall(sill, style.sill_out_m, kit.grain, Label.WALL, tint, in_m=style.recess_m)]
    around = {
        "none": [],
        "lintel": [(x0 - 0.15, z1, x1 + 0.15, z1 + 0.2)],
        "surround": [(x0 - 0.13, z0, x0, z1), (x1, z0, x1 + 0.13, z1), (x0 - 0.13, z1, x1 + 0.13, z1 + 0.16)],
    }
    parts += [on_wall(np.column_stack(piece), 0.035, kit.grain, Label.WALL, tint) for piece in around[style.head]]
    return join(parts)


def windows(kit: Kit, rng: Rng, openings: Iterable[Opening], broken: float) -> Part:
    """All windows and other glazed openings, style by style."""
    groups: dict[tuple[Style, str, float], list[tuple[float, float, float, float]]] = {}
    for opening in openings:
        if opening.kind in ("window", "shop", "glazed", "balcony"):
            groups.setdefault((opening.style, opening.kind, opening.recess_m), []).append(opening.rect)
    parts = []
    for (style, kind, depth), rect in groups.items():
        parts += [glazing(kit, rng, rect, depth, style.columns, broken), frames(kit, rect, style, depth)]
        if kind in ("window", "shop"):
            parts.append(sills_and_heads(kit, rect, style, rng))
    return join(parts)


def infills(kit: Kit, openings: Iterable[Opening]) -> Part:
    """Openings that were closed with other material, a little behind the wall's face."""
    rect = rects(tuple(opening for opening in openings if opening.kind == "blocked"))
    low, high = _xz(rect[:, 0], rect[:, 1], 0.06), _xz(rect[:, 2], rect[:, 3], 0.1)
    return boxes(low, high, kit.infill, Label.WALL, faces=("-y",))


def bands(kit: Kit, face: Face, openings: tuple[Opening, ...], levels_m: ArrayLike, plinth_m: float) -> Part:
    """A plinth, and narrow courses of stone at some heights; both end where an opening is in the way."""
    holes = rects(openings)
    plinth = cells_without(holes, (0.0, FOOT_M, face.length_m, plinth_m))
    parts = [on_wall(plinth, 0.03, kit.grain, Label.WALL, 0.75 * kit.stone)]
    for z in np.asarray(levels_m, np.float64):
        course = cells_without(holes + [-0.05, 0, 0.05, 0], (0.0, z, face.length_m, z + 0.14))
        parts.append(on_wall(course, 0.045, kit.grain, Label.WALL, kit.stone))
    return join(parts)


def on_its_side(part: Part, building: Building, wall: int) -> Part:
    """From a wall's own frame into the building's."""
    start = np.array(building.outline[wall])
    edge = np.array(building.outline[(wall + 1) % len(building.outline)]) - start
    return part.placed(float(np.degrees(np.arctan2(edge[1], edge[0]))), (*start, 0.0))
