# SPDX-License-Identifier: Apache-2.0
"""Buildings that are only seen from far away: the same shapes and colours, with painted windows and few triangles."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from skymoor.simulate.building.covers import COLOURS, roof_texture
from skymoor.simulate.building.facades import FOOT_M, on_its_side
from skymoor.simulate.building.kit import wall_colour
from skymoor.simulate.building.materials import Array32, blend
from skymoor.simulate.building.openings import openings_of, wall_lengths
from skymoor.simulate.building.painting import flat_colour
from skymoor.simulate.building.roofs import parapet_m, profile, span_of
from skymoor.simulate.building.solids import ON_FLOOR, boxes, solid
from skymoor.simulate.building.weathering import runoff
from skymoor.simulate.light.pages import WHITE, Pages
from skymoor.simulate.mesh import Array, Label, Part, join, quads, rectangles_of, stream
from skymoor.simulate.plan import Building

_WALL_TEXEL_M, _ROOF_TEXEL_M = 0.10, 0.12


def coarse_parts(building: Building, pages: Pages) -> Part:
    """Walls, roof and a few blocks on it, in the building's frame; fewer than 150 triangles for most outlines."""
    lengths = wall_lengths(building)
    widest = int(np.argmax(lengths))
    top = max(float(profile(building, wall)[:, 1].max()) for wall in range(len(lengths)))
    page = pages.add(_painted(building, widest, top), _WALL_TEXEL_M)
    walls = [on_its_side(_wall(building, wall, page, top), building, wall) for wall in range(len(lengths))]
    return solid(join([*walls, _roof(building, pages)]))


def _painted(building: Building, wall: int, top_m: float) -> Array32:
    """A wall (h, w, 3) with dark windows, lighter frames and doors."""
    rng = stream(building.looks, "far wall")
    length = float(wall_lengths(building)[wall])
    shape = int(np.ceil(top_m / _WALL_TEXEL_M)) + 5, int(np.ceil(length / _WALL_TEXEL_M))
    albedo = flat_colour(rng, wall_colour(building), shape, _WALL_TEXEL_M)
    runoff(albedo, rng, _WALL_TEXEL_M, 1.0)
    for opening in openings_of(building, wall):
        x0, x1 = (round(x / _WALL_TEXEL_M) for x in (opening.x0, opening.x1))
        y0, y1 = (max(round((top_m - z) / _WALL_TEXEL_M), 0) for z in (opening.z1, opening.z0))
        tone = np.array([0.06, 0.07, 0.08]) * rng.uniform(0.5, 2.0)
        if opening.kind in ("roller", "dock", "steel", "blocked"):
            tone = wall_colour(building) * rng.uniform(0.5, 0.9)
        albedo[y0:y1, x0:x1] = tone
        albedo[y0 : y0 + 1, x0:x1] *= np.float32(0.6)
        albedo[y0:y1, (x0 + x1) // 2] *= np.float32(1.8)
        albedo[y1 : y1 + 1, x0:x1] *= np.float32(1.25)
    down = np.linspace(0, 1, shape[0], dtype=np.float32)[:, None] ** 6
    blend(albedo, np.broadcast_to(0.3 * down, shape), (0.13, 0.115, 0.085))
    return np.clip(albedo, 0.02, 0.7)


def _wall(building: Building, wall: int, page: int, top_m: float) -> Part:
    """A wall and what rises above it; shorter walls show the left part of the page."""
    line = profile(building, wall)
    a, b = line[:-1], line[1:]
    foot = np.full(len(a), FOOT_M)
    zero = np.zeros(len(a))
    corners = np.stack(
        [
            np.column_stack([a[:, 0], zero, foot]),
            np.column_stack([b[:, 0], zero, foot]),
            np.column_stack([b[:, 0], zero, b[:, 1]]),
            np.column_stack([a[:, 0], zero, a[:, 1]]),
        ],
        axis=1,
    )
    uv = np.stack([corners[..., 0] + 0.0 * corners[..., 1], top_m - np.maximum(corners[..., 2], -0.4)], axis=-1)
    return quads(corners, uv, page, Label.WALL)


def _roof(building: Building, pages: Pages) -> Part:
    rng = stream(building.looks, "far roof")
    low, high = np.array(building.outline).min(axis=0), np.array(building.outline).max(axis=0)
    choices = COLOURS[building.cover]
    colour = np.array(choices[rng.integers(len(choices))])
    size = high - low if building.roof == "flat" else np.array([12.0, 9.0])
    shape = int(np.ceil(size[1] / _ROOF_TEXEL_M)), int(np.ceil(size[0] / _ROOF_TEXEL_M))
    texture = roof_texture(building.cover, rng, shape, _ROOF_TEXEL_M, colour, plain=False)
    page = pages.add(texture, _ROOF_TEXEL_M)
    if building.roof == "flat":
        return join([_deck(building, page, low, high), _blocks(building, low, high)])
    span = span_of(building)
    faces = _slopes(building, span.half_m, span.half_across_m, building.walls_m, span.rise_m, span.teeth)
    along = faces[:, 1] - faces[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    up = faces[:, 2] - faces[:, 1]
    up = up - np.einsum("ij,ij->i", up, along)[:, None] * along
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    away = faces - faces[:, :1]
    uv = np.stack([np.einsum("ijk,ik->ij", away, along), -np.einsum("ijk,ik->ij", away, up)], axis=-1)
    part = quads(faces, uv, page, Label.ROOF)
    return part.placed(90.0, (0, 0, 0)) if span.turned else part


def _slopes(building: Building, a: float, b: float, eaves: float, rise: float, teeth: int) -> Array:
    """Corners (n, 4, 3) of the sloping faces, each from its eaves up, with a small overhang."""
    o = 0.4
    low, top = eaves - o * rise / b, eaves + rise
    if building.roof == "gable":
        ridge = [[a + o, 0, top], [-a - o, 0, top]]
        south = [[-a - o, -b - o, low], [a + o, -b - o, low], *ridge]
        north = [[a + o, b + o, low], [-a - o, b + o, low], *ridge[::-1]]
        return np.array([south, north], dtype=np.float64)
    if building.roof == "hip":
        p = max(a - b, 0.0)
        c = [[-a, -b, eaves], [a, -b, eaves], [a, b, eaves], [-a, b, eaves]]
        e, w = [p, 0, top], [-p, 0, top]
        faces = [[c[0], c[1], e, w], [c[1], c[2], e, e], [c[2], c[3], w, e], [c[3], c[0], w, w]]
        return np.array(faces, dtype=np.float64)
    if building.roof == "shed":
        return np.array([[[-a, -b, eaves], [a, -b, eaves], [a, b, top], [-a, b, top]]], dtype=np.float64)
    x = np.linspace(-a, a, teeth + 1)
    slopes = [[[q, -b, eaves], [q, b, eaves], [p, b, top], [p, -b, top]] for p, q in pairwise(x)]
    lights = [[[p, b, eaves], [p, -b, eaves], [p, -b, top], [p, b, top]] for p in x[:-1]]
    return np.array(slopes + lights, dtype=np.float64)


def _deck(building: Building, page: int, low: Array, high: Array) -> Part:
    x0, y0, x1, y1 = rectangles_of(building.outline).T
    z = np.full_like(x0, building.walls_m)
    deck = np.stack([np.stack(c, axis=1) for c in ((x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z))], axis=1)
    uv = np.stack([deck[..., 0] - low[0], high[1] - deck[..., 1]], axis=-1)
    inner = []
    for wall, length in enumerate(wall_lengths(building)):
        top = building.walls_m + parapet_m(building)
        rim = boxes(
            [[0, 0, building.walls_m]], [[length, 0.25, top]], WHITE, Label.ROOF, (0.3, 0.3, 0.3), faces=("+y", "+z")
        )
        inner.append(on_its_side(rim, building, wall))
    return join([quads(deck, uv, page, Label.ROOF), *inner])


def _blocks(building: Building, low: Array, high: Array) -> Part:
    """Up to six machines."""
    rng = stream(building.looks, "far roof things")
    cells = rectangles_of(building.outline)
    cell = cells[np.argmax((cells[:, 2] - cells[:, 0]) * (cells[:, 3] - cells[:, 1]))]
    room = cell[2:] - cell[:2] - 4.5
    if (room <= 0).any():
        return join([])
    n = int(rng.integers(1, 7))
    corner = cell[:2] + 1.2 + rng.random((n, 2)) * room
    size = rng.uniform((0.9, 0.9, 0.6), (2.2, 2.0, 1.9), (n, 3))
    foot = np.column_stack([corner, np.full(n, building.walls_m)])
    return boxes(foot, foot + size, WHITE, Label.OBJECT, rng.uniform(0.2, 0.42, (n, 1)) * np.ones(3), faces=ON_FLOOR)
