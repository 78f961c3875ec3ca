# SPDX-License-Identifier: Apache-2.0
"""What hangs on walls for years: signs, downpipes, cables, machines, lamps, ladders, in the wall's own frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skymoor.simulate.building.kit import Kit
from skymoor.simulate.building.materials import Rng
from skymoor.simulate.building.openings import Opening, rects
from skymoor.simulate.building.signs import board, firm, warning
from skymoor.simulate.building.solids import bars, boxes, on_wall
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.mesh import Array, Label, Part, cylinder, join, parallelograms
from skymoor.simulate.plan import Building

Rect = tuple[float, float, float, float]


@dataclass
class Free:
    """Room on a wall: what is taken so far, as rectangles x0, z0, x1, z1, and the wall's own size."""

    taken: Array
    length_m: float
    top_m: float

    def find(self, rng: Rng, size: tuple[float, float], heights: tuple[float, float], tries: int = 12) -> Rect | None:
        """A free place for something of (width, height) whose foot lies between `heights`, or None; takes it."""
        if self.length_m < size[0] + 0.6 or heights[1] < heights[0]:
            return None
        for _ in range(tries):
            x = float(rng.uniform(0.3, self.length_m - 0.3 - size[0]))
            z = float(rng.uniform(*heights))
            place = (x, z, x + size[0], z + size[1])
            if place[3] < self.top_m - 0.1 and self.take(place):
                return place
        return None

    def take(self, place: Rect, gap_m: float = 0.12) -> bool:
        """Take a place if it is free, with a gap round it."""
        t = self.taken
        x0, z0, x1, z1 = place
        clash = (t[:, 0] < x1 + gap_m) & (x0 - gap_m < t[:, 2]) & (t[:, 1] < z1 + gap_m) & (z0 - gap_m < t[:, 3])
        if clash.any():
            return False
        self.taken = np.vstack([t, [place]])
        return True


def room_on(building: Building, length_m: float, openings: tuple[Opening, ...]) -> Free:
    """A wall's free room beside its openings and what surrounds them."""
    around = rects(openings) + [-0.2, -0.15, 0.2, 0.3]
    for k, opening in enumerate(openings):
        if opening.kind in ("glazed", "steel", "balcony"):
            around[k] += [-0.8, -0.5, 0.8, 1.0]
    return Free(around, length_m, building.walls_m)


def fittings(building: Building, kit: Kit, pages: Pages, rng: Rng, free: Free, face: str, *, hall: bool) -> Part:
    """A mixture that suits the side of the building: names in front, machines and pipes behind."""
    front = face == "front"
    parts = [downpipes(building, kit, rng, free)]
    if front or rng.random() < 0.3:
        parts.append(name_board(building, kit, pages, rng, free, hall=hall))
    counts = {"machine": 1 if front else 4, "box": 3, "vent": 4, "lamp": 4, "notice": 3, "cable": 2 if front else 4}
    makers = {"machine": machine, "box": meter_box, "vent": vent, "lamp": lamp, "cable": cable}
    for name, most in counts.items():
        for _ in range(int(rng.integers(0, most + 1)) if free.length_m > 5 else 0):
            if name == "notice":
                parts.append(notice(kit, pages, rng, free))
            else:
                parts.append(makers[name](kit, rng, free))
    if not front and rng.random() < (0.7 if hall else 0.3):
        parts.append(ladder(building, kit, rng, free))
    if hall and not front and free.length_m > 10 and rng.random() < 0.6:
        parts.append(outside_stairs(building, kit, rng, free))
    return join(parts)


def downpipes(building: Building, kit: Kit, rng: Rng, free: Free) -> Part:
    """A pipe every ten metres or so where no window is in the way, with a head and brackets."""
    parts = []
    count = max(1, round(free.length_m / 11))
    for wished in np.linspace(0.25, free.length_m - 0.35, count + 1)[: count + (free.length_m > 6)]:
        for x in wished + np.array([0.0, 0.3, -0.3, 0.6, -0.6, 0.9, -0.9, 1.3]):
            if 0.15 < x < free.length_m - 0.15 and free.take((x - 0.06, -1.0, x + 0.06, building.walls_m - 0.2), 0.02):
                parts.append(_pipe(building, kit, rng, float(x)))
                break
    return join(parts)


def _pipe(building: Building, kit: Kit, rng: Rng, x: float) -> Part:
    top = building.walls_m - 0.1
    pipe = cylinder((x, -0.09, -2.5), 0.05, top + 2.4, kit.grain, Label.OBJECT, kit.metal, facets=7)
    z = np.arange(0.5, top - 0.3, rng.uniform(1.6, 2.2))
    clips = np.column_stack([0 * z + x - 0.08, z, 0 * z + x + 0.08, z + 0.04])
    head = [[x - 0.14, top - 0.25, x + 0.14, top]]
    return join([pipe, on_wall(np.vstack([clips, head]), 0.16, kit.grain, Label.OBJECT, 0.9 * kit.metal)])


def name_board(building: Building, kit: Kit, pages: Pages, rng: Rng, free: Free, *, hall: bool) -> Part:
    """The name of a firm, over the ground floor or high up on a hall."""
    text = firm(rng)
    height = float(rng.uniform(0.9, 1.5) if hall else rng.uniform(0.42, 0.65))
    width = min(height * max(len(text) * 0.62, 3.0), 0.6 * free.length_m)
    level = building.walls_m - 1.9 - height if hall else building.storey_m - 0.35
    place = free.find(rng, (width, height), (level, level + 0.3), tries=40)
    if place is None:
        place = free.find(rng, (width, height), (building.storey_m - 0.9, building.walls_m - height - 0.2), tries=40)
    return join([]) if place is None else plate(kit, pages, rng, place, text, 0.015)


def notice(kit: Kit, pages: Pages, rng: Rng, free: Free) -> Part:
    """A small sign at the height of the eye."""
    place = free.find(rng, (float(rng.uniform(0.3, 0.9)), float(rng.uniform(0.2, 0.5))), (1.3, 2.1))
    return join([]) if place is None else plate(kit, pages, rng, place, warning(rng), 0.01)


def plate(kit: Kit, pages: Pages, rng: Rng, place: Rect, text: str, texel_m: float) -> Part:
    """A painted board that stands 4 to 10 cm before the wall."""
    x0, z0, x1, z1 = place
    out = float(rng.uniform(0.04, 0.1))
    shape = max(8, round((z1 - z0) / texel_m)), max(8, round((x1 - x0) / texel_m))
    page = pages.add(board(rng, text, shape, texel_m), texel_m)
    body = on_wall([place], out - 0.003, kit.grain, Label.OBJECT, 0.6 * kit.metal)
    front = parallelograms([[x0, -out, z0]], [[x1 - x0, 0, 0]], [[0, 0, z1 - z0]], page, Label.OBJECT)
    half = np.float32(0.5 * texel_m)  # keeps the page's repeats out of its borders
    return join([body, replace(front, uv=np.clip(front.uv, half, front.uv.max(axis=(0, 1)) - half))])


def machine(kit: Kit, rng: Rng, free: Free) -> Part:
    """An air conditioner: a box with a grille on two brackets, and its pipe."""
    size = float(rng.uniform(0.75, 0.95)), float(rng.uniform(0.5, 0.7))
    place = free.find(rng, size, (0.4, max(0.6, free.top_m - 1.5)))
    if place is None:
        return join([])
    x0, z0, x1, z1 = place
    tint = np.array([0.46, 0.46, 0.43]) * rng.uniform(0.7, 1.05)
    slats = np.arange(z0 + 0.06, z1 - 0.05, 0.05)
    grille = np.column_stack([0 * slats + x0 + 0.06, slats, 0 * slats + x1 - 0.26, slats + 0.022])
    pipe = [[x1 - 0.12, max(z0 - 0.9, -1.0), x1 - 0.07, z0]]
    return join(
        [
            on_wall([place], 0.36, kit.grain, Label.OBJECT, tint, in_m=-0.06),
            on_wall(grille, 0.375, kit.grain, Label.OBJECT, 0.25 * tint, in_m=-0.34),
            on_wall(
                [[x0 + 0.1, z0 - 0.05, x0 + 0.14, z0], [x1 - 0.14, z0 - 0.05, x1 - 0.1, z0]],
                0.38,
                kit.grain,
                Label.OBJECT,
                kit.metal,
            ),
            on_wall(pipe, 0.05, kit.grain, Label.OBJECT, 0.7 * tint),
        ]
    )


def meter_box(kit: Kit, rng: Rng, free: Free) -> Part:
    """A grey cupboard for meters and switches, with a cable down to the ground."""
    place = free.find(rng, (float(rng.uniform(0.35, 0.8)), float(rng.uniform(0.5, 1.0))), (0.4, 1.0))
    if place is None:
        return join([])
    x0, z0, x1, _ = place
    tint = np.array([0.33, 0.34, 0.33]) * rng.uniform(0.6, 1.2)
    cable = [[(x0 + x1) / 2 - 0.02, -1.0, (x0 + x1) / 2 + 0.02, z0]]
    lock = [[x1 - 0.08, z0 + 0.3, x1 - 0.05, z0 + 0.36]]
    return join(
        [
            on_wall([place], float(rng.uniform(0.14, 0.26)), kit.grain, Label.OBJECT, tint),
            on_wall(lock, 0.29, kit.grain, Label.OBJECT, 0.3 * tint),
            on_wall(cable, 0.04, kit.grain, Label.OBJECT, 0.5 * tint),
        ]
    )


def vent(kit: Kit, rng: Rng, free: Free) -> Part:
    """A grille with slats."""
    side = float(rng.uniform(0.2, 0.55))
    place = free.find(rng, (side, 0.8 * side), (0.15, max(0.3, free.top_m - 1.0)))
    if place is None:
        return join([])
    x0, z0, x1, z1 = place
    slats = np.arange(z0 + 0.03, z1 - 0.02, 0.045)
    bars_ = np.column_stack([0 * slats + x0 + 0.02, slats, 0 * slats + x1 - 0.02, slats + 0.02])
    tint = 0.8 * kit.metal * rng.uniform(0.7, 1.2)
    return join(
        [
            on_wall([place], 0.02, kit.grain, Label.OBJECT, 0.35 * tint),
            on_wall(bars_, 0.045, kit.grain, Label.OBJECT, tint),
        ]
    )


def lamp(kit: Kit, rng: Rng, free: Free) -> Part:
    """A floodlight on an arm, or a bulkhead lamp."""
    place = free.find(rng, (0.26, 0.2), (2.5, 3.4))
    if place is None:
        return join([])
    x0, z0, x1, z1 = place
    if rng.random() < 0.5:
        return on_wall([place], 0.12, kit.grain, Label.OBJECT, (0.48, 0.48, 0.44))
    arm = on_wall([[x0 + 0.11, z1 - 0.05, x1 - 0.11, z1]], 0.5, kit.grain, Label.OBJECT, 0.6 * kit.metal)
    head = boxes([[x0, -0.62, z0]], [[x1, -0.42, z1]], kit.grain, Label.OBJECT, (0.10, 0.10, 0.10))
    return join([arm, head])


def cable(kit: Kit, rng: Rng, free: Free) -> Part:
    """A conduit up the wall and along it, round nothing: it takes only what is free."""
    height = float(rng.uniform(1.5, 0.8 * free.top_m))
    place = free.find(rng, (0.05, height), (-0.9, -0.8))
    if place is None:
        return join([])
    x0, _, x1, z1 = place
    way = float(rng.uniform(0.6, 3.0)) * rng.choice([-1, 1])
    side = (min(x0, x0 + way), z1, max(x1, x1 + way), z1 + 0.05)
    pieces = [place]
    if side[0] > 0.1 and side[2] < free.length_m - 0.1 and free.take(side, 0.0):
        pieces.append(side)
    return on_wall(pieces, 0.05, kit.grain, Label.OBJECT, kit.metal * rng.uniform(0.5, 1.2))


def ladder(building: Building, kit: Kit, rng: Rng, free: Free) -> Part:
    """Rungs up to the roof, from above the reach of children."""
    start = 2.2
    place = free.find(rng, (0.5, building.walls_m - start - 0.15), (start, start + 0.01))
    if place is None:
        return join([])
    x0, z0, x1, _ = place
    top = building.walls_m + 1.0
    rails = np.array([[[x, -0.2, z0], [x, -0.2, top]] for x in (x0, x1)])
    z = np.arange(z0 + 0.1, top - 0.3, 0.3)
    rungs = np.stack([np.column_stack([0 * z + x, 0 * z - 0.2, z]) for x in (x0, x1)], axis=1)
    stays = np.arange(z0 + 0.4, building.walls_m, 1.8)
    hold = np.concatenate(
        [np.column_stack([0 * stays + x - 0.02, stays, 0 * stays + x + 0.02, stays + 0.04]) for x in (x0, x1)]
    )
    tint = kit.metal * rng.uniform(0.7, 1.0)
    return join(
        [
            bars(rails[:, 0], rails[:, 1], 0.045, kit.grain, Label.OBJECT, tint),
            bars(rungs[:, 0], rungs[:, 1], 0.025, kit.grain, Label.OBJECT, tint),
            on_wall(hold, 0.2, kit.grain, Label.OBJECT, tint),
        ]
    )


def outside_stairs(building: Building, kit: Kit, rng: Rng, free: Free) -> Part:
    """A steel flight along the wall up to a landing with a door leaf."""
    rise = min(3.2, building.walls_m - 2.6)
    run = 1.15 * rise
    if rise < 2.0:
        return join([])
    place = free.find(rng, (run + 1.5, rise + 2.4), (-0.3, -0.29), tries=40)
    if place is None:
        return join([])
    x0, tint, n = place[0], kit.metal * rng.uniform(0.7, 1.0), int(rise / 0.19)
    k = np.arange(n)
    z, x = (k + 1) * rise / n, x0 + k * run / n
    treads = boxes(
        np.column_stack([x, 0 * x - 1.15, z - 0.04]),
        np.column_stack([x + 0.26, 0 * x - 0.1, z]),
        kit.grain,
        Label.OBJECT,
        tint,
    )
    landing = boxes([[x0 + run, -1.15, rise - 0.08]], [[x0 + run + 1.4, 0, rise]], kit.grain, Label.OBJECT, tint)
    door = on_wall([[x0 + run + 0.2, rise, x0 + run + 1.15, rise + 2.1]], 0.04, kit.grain, Label.WALL, kit.door)
    strings = np.array([[[x0 - 0.3, y, -0.3], [x0 + run, y, rise - 0.1]] for y in (-1.15, -0.1)])
    rails = np.array([[[x0, -1.15, h], [x0 + run, -1.15, rise + h]] for h in (0.5, 1.0)])
    level = np.array([[[x0 + run, -1.15, rise + h], [x0 + run + 1.4, -1.15, rise + h]] for h in (0.5, 1.0)])
    at = np.concatenate([np.linspace(x0, x0 + run, 5), [x0 + run + 1.38]])
    foot = np.column_stack([at, 0 * at - 1.15, np.minimum((at - x0) / run, 1) * rise])
    legs = np.array([[[x0 + run + d, -1.1, -2.5], [x0 + run + d, -1.1, rise]] for d in (0.05, 1.35)])
    lines = np.concatenate([rails, level, np.stack([foot, foot + [0, 0, 1.0]], axis=1)])
    return join(
        [
            treads,
            landing,
            door,
            bars(strings[:, 0], strings[:, 1], 0.12, kit.grain, Label.OBJECT, 0.8 * tint),
            bars(legs[:, 0], legs[:, 1], 0.1, kit.grain, Label.OBJECT, 0.8 * tint),
            bars(lines[:, 0], lines[:, 1], 0.04, kit.grain, Label.OBJECT, tint),
        ]
    )
