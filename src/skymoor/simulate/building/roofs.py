# SPDX-License-Identifier: Apache-2.0
"""Roofs: flat ones behind parapets, and pitched ones on rectangles; what stands on them is in `rooftop`.

A pitched roof is made with its ridge along x, `Span` says how it lies on the building.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from skymoor.errors import InputError
from skymoor.simulate.building.covers import COLOURS, roof_texture
from skymoor.simulate.building.kit import Kit
from skymoor.simulate.building.materials import Array32, Rng
from skymoor.simulate.building.solids import bars, boxes
from skymoor.simulate.building.weathering import repairs
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.mesh import Array, Label, Part, cuboid, join, parallelograms, quads, rectangles_of, stream
from skymoor.simulate.plan import Building

_THICK_M = 0.14
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Span:
    """A pitched roof: half lengths along and across the ridge, rise, overhang, number of teeth, quarter turns."""

    half_m: float
    half_across_m: float
    rise_m: float
    overhang_m: float
    teeth: int
    turned: bool


def parapet_m(building: Building) -> float:
    """How far the walls of a flat roof rise above it; 0 for pitched roofs."""
    return float(stream(building.looks, "parapet").uniform(0.3, 0.9)) if building.roof == "flat" else 0.0


def span_of(building: Building) -> Span:
    """The pitch of a building's roof. Raises InputError where the outline is no rectangle."""
    corners = np.array(building.outline)
    if len(corners) != 4:
        raise InputError(f"building {building.name}: a {building.roof} roof needs four corners; make its roof flat")
    rng = stream(building.looks, "roof")
    half = (corners.max(axis=0) - corners.min(axis=0)) / 2
    turned = bool(half[1] > half[0])
    along, across = (half[1], half[0]) if turned else (half[0], half[1])
    steep = rng.uniform(28, 40) if building.cover == "tiles" else rng.uniform(9, 17)
    rise = float(across * np.tan(np.radians(steep)))
    if building.roof == "shed":
        rise = min(rise, float(2 * across * np.tan(np.radians(rng.uniform(6, 11)))))
    teeth = max(2, round(2 * along / rng.uniform(5.0, 7.0)))
    if building.roof == "sawtooth":
        rise = float(rng.uniform(0.24, 0.34) * 2 * along / teeth)
    return Span(float(along), float(across), rise, float(rng.uniform(0.3, 0.6)), teeth, turned)


def profile(building: Building, wall: int) -> Array:
    """What the wall is above its upright part: x, z (k, 2) from its left end to its right one; flat for most."""
    corners = np.array(building.outline)
    edge = corners[(wall + 1) % len(corners)] - corners[wall]
    length, low = float(np.linalg.norm(edge)), building.walls_m + parapet_m(building)
    level = np.array([[0.0, low], [length, low]])
    if building.roof in ("flat", "hip"):
        return level
    span = span_of(building)
    east, north = (edge[1], -edge[0]) if span.turned else (edge[0], edge[1])
    high = low + span.rise_m
    across = abs(north) > abs(east)
    if building.roof == "gable":
        return np.array([[0.0, low], [length / 2, high], [length, low]]) if across else level
    if building.roof == "shed":
        if across:
            return np.array([[0.0, low], [length, high]] if north > 0 else [[0.0, high], [length, low]])
        return level if east > 0 else np.array([[0.0, high], [length, high]])
    if across:
        return level
    teeth = pairwise(np.linspace(0, length, span.teeth + 1))
    line = np.array([point for a, b in teeth for point in ((a, high), (b, low))])
    return line if east > 0 else np.column_stack([length - line[::-1, 0], line[::-1, 1]])


def roof_part(building: Building, kit: Kit, pages: Pages, texel_m: float) -> Part:
    """The roof without what stands on it, in the building's frame."""
    rng = stream(building.looks, "cover")
    painter = _Painter(building, pages, rng, texel_m)
    if building.roof == "flat":
        return _flat(building, kit, painter)
    span = span_of(building)
    makers = {"gable": _gable, "hip": _hip, "shed": _shed, "sawtooth": _sawtooth}
    part = makers[building.roof](building.walls_m, span, kit, painter)
    return part.placed(90.0, (0, 0, 0)) if span.turned else part


class _Painter:
    """Paints one page after the other in a building's roof colour."""

    def __init__(self, building: Building, pages: Pages, rng: Rng, texel_m: float) -> None:
        choices = COLOURS[building.cover]
        self.colour: Array = np.array(choices[rng.integers(len(choices))]) * rng.uniform(0.85, 1.1)
        self._plain = building.cover == "membrane" and stream(building.looks, "plain roof").random() < 0.3
        self._cover, self._pages, self._rng, self._texel_m = building.cover, pages, rng, texel_m

    def page(self, width_m: float, height_m: float) -> int:
        """A page of its own for a slope of this size."""
        shape = int(np.ceil(height_m / self._texel_m)) + 1, int(np.ceil(width_m / self._texel_m)) + 1
        albedo: Array32 = roof_texture(self._cover, self._rng, shape, self._texel_m, self.colour, plain=self._plain)
        if not self._plain:
            repairs(albedo, self._rng, self._texel_m, 0.4)
        return self._pages.add(albedo, self._texel_m)


def _flat(building: Building, kit: Kit, painter: _Painter) -> Part:
    """The deck inside the parapet, and the parapet's inner faces and metal caps."""
    corners = np.array(building.outline)
    low, size = corners.min(axis=0), np.ptp(corners, axis=0)
    x0, y0, x1, y1 = rectangles_of(building.outline).T
    z = np.full_like(x0, building.walls_m)
    deck = np.stack([np.stack(c, axis=1) for c in ((x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z))], axis=1)
    uv = np.stack([deck[..., 0] - low[0], low[1] + size[1] - deck[..., 1]], axis=-1)
    parts = [quads(deck, uv, painter.page(float(size[0]), float(size[1])), Label.ROOF)]
    top, height = building.walls_m + parapet_m(building), parapet_m(building)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge = end - start
        length, angle = float(np.linalg.norm(edge)), float(np.degrees(np.arctan2(edge[1], edge[0])))
        inner = parallelograms(
            [[length, 0.28, top - height]], [[-length, 0, 0]], [[0, 0, height]], kit.grain, Label.WALL, 0.7 * kit.stone
        )
        cap = boxes([[-0.04, -0.04, top - 0.05]], [[length + 0.04, 0.32, top + 0.04]], kit.grain, Label.ROOF, kit.metal)
        parts.append(join([inner, cap]).placed(angle, (*start, 0.0)))
    return join(parts)


def _slope(origin: Array, along: Array, up: Array, kit: Kit, painter: _Painter) -> Part:
    """A slab whose upper face is covered; `origin` is the left end of its eaves as seen from outside."""
    page = painter.page(float(np.linalg.norm(along)), float(np.linalg.norm(up)))
    body = cuboid(origin, [along, up, _THICK_M * _UP], kit.grain, Label.ROOF, 0.6 * kit.stone)
    return join([body, parallelograms(origin + (_THICK_M + 0.004) * _UP, along, up, page, Label.ROOF)])


def _gutter(x0: float, x1: float, y: float, z: float, kit: Kit) -> Part:
    """A gutter along x, outside of the eaves at y (its sign says on which side)."""
    out = np.sign(y) * 0.13
    low, high = sorted((y, y + out))
    return boxes([[x0, low, z - 0.02]], [[x1, high, z + 0.09]], kit.grain, Label.OBJECT, kit.metal)


def _gable(eaves: float, span: Span, kit: Kit, painter: _Painter) -> Part:
    a, b = span.half_m + span.overhang_m * 0.8, span.half_across_m + span.overhang_m
    low = eaves - span.overhang_m * span.rise_m / span.half_across_m
    top = eaves + span.rise_m
    parts = []
    for side in (-1.0, 1.0):
        origin, along = np.array([side * a, side * b, low]), np.array([-side * 2 * a, 0.0, 0.0])
        parts.append(_slope(origin, along, np.array([0.0, -side * b, top - low]), kit, painter))
        parts.append(_gutter(-a, a, side * b, low, kit))
    ridge = bars(
        [[-a, 0, top + _THICK_M]], [[a, 0, top + _THICK_M]], 0.17, kit.grain, Label.ROOF, 0.85 * painter.colour
    )
    return join([*parts, ridge])


def _hip(eaves: float, span: Span, kit: Kit, painter: _Painter) -> Part:
    a, b = span.half_m + span.overhang_m, span.half_across_m + span.overhang_m
    top, peak = eaves + span.rise_m + _THICK_M, max(span.half_m - span.half_across_m, 0.0)
    z = eaves + 0.02
    parts = [
        parallelograms([[-a, b, z]], [[2 * a, 0, 0]], [[0, -2 * b, 0]], kit.grain, Label.ROOF, 0.6 * kit.stone),
        boxes(
            [[-a, -b, z], [-a, b - 0.02, z]],
            [[a, -b + 0.02, z + 0.12], [a, b, z + 0.12]],
            kit.grain,
            Label.ROOF,
            0.5 * kit.stone,
        ),
        boxes(
            [[-a, -b, z], [a - 0.02, -b, z]],
            [[-a + 0.02, b, z + 0.12], [a, b, z + 0.12]],
            kit.grain,
            Label.ROOF,
            0.5 * kit.stone,
        ),
    ]
    z += 0.12
    corners = np.array([[-a, -b, z], [a, -b, z], [a, b, z], [-a, b, z]])
    ends = np.array([[-peak, 0.0, top], [peak, 0.0, top]])
    for k, (left, right) in enumerate(((0, 1), (1, 1), (1, 0), (0, 0))):
        face = np.array([corners[k], corners[(k + 1) % 4], ends[right], ends[left]])
        parts.append(_polygon(face, painter))
    hips = np.array([[corners[0], ends[0]], [corners[1], ends[1]], [corners[2], ends[1]], [corners[3], ends[0]], ends])
    parts.append(bars(hips[:, 0], hips[:, 1], 0.16, kit.grain, Label.ROOF, 0.85 * painter.colour))
    parts += [_gutter(-a, a, side * b, z - 0.1, kit) for side in (-1, 1)]
    return join(parts)


def _polygon(face: Array, painter: _Painter) -> Part:
    """A sloping face (4, 3) whose first edge is its eaves, covered by a page of its own."""
    along = (face[1] - face[0]) / np.linalg.norm(face[1] - face[0])
    up = np.cross(np.cross(along, face[2] - face[0]), along)
    up /= np.linalg.norm(up)
    height = float((face[2] - face[0]) @ up)
    uv = np.stack([(face - face[0]) @ along, height - (face - face[0]) @ up], axis=-1)
    return quads(face, uv, painter.page(float(uv[:, 0].max()), height), Label.ROOF)


def _shed(eaves: float, span: Span, kit: Kit, painter: _Painter) -> Part:
    o = span.overhang_m
    a, b = span.half_m + o, span.half_across_m + o
    tangent = span.rise_m / (2 * span.half_across_m)
    low = eaves - o * tangent
    up = np.array([0.0, 2 * b, 2 * b * tangent])
    return join(
        [
            _slope(np.array([-a, -b, low]), np.array([2 * a, 0.0, 0.0]), up, kit, painter),
            _gutter(-a, a, -b, low, kit),
        ]
    )


def _sawtooth(eaves: float, span: Span, kit: Kit, painter: _Painter) -> Part:
    b, rise = span.half_across_m, span.rise_m
    starts = np.linspace(-span.half_m, span.half_m, span.teeth + 1)
    parts = []
    for x0, x1 in pairwise(starts):
        up = np.array([x0 - x1, 0.0, rise])
        parts.append(_slope(np.array([x1, -b, eaves]), np.array([0.0, 2 * b, 0.0]), up, kit, painter))
        y = np.append(np.arange(b, -b + 0.6, -1.2), -b)
        low, high = eaves + 0.4, eaves + rise - 0.05
        pane = np.outer(np.diff(y), [0.0, 1.0, 0.0])
        origin = np.column_stack([np.full(len(pane), x0 - 0.01), y[:-1], np.full(len(pane), low)])
        glass = parallelograms(origin, pane, [[0, 0, high - low]], kit.rooms.page, Label.GLASS, (1.6, 1.6, 1.6))
        foot = parallelograms(
            [[x0 - 0.01, b, eaves]], [[0, -2 * b, 0]], [[0, 0, 0.4]], kit.grain, Label.ROOF, kit.metal
        )
        posts = boxes(
            np.column_stack([0 * y + x0 - 0.06, y - 0.03, 0 * y + low]),
            np.column_stack([0 * y + x0, y + 0.03, 0 * y + high]),
            kit.grain,
            Label.OBJECT,
            kit.metal,
            faces=("-x", "-y", "+y"),
        )
        shift = np.array([0.3 * len(parts), 0.2], np.float32)
        parts += [replace(glass, uv=glass.uv + shift), foot, posts]
    return join(parts)
