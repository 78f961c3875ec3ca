# SPDX-License-Identifier: Apache-2.0
"""What stands on roofs: machines, ducts, skylights, stair heads, vents, antennas, chimneys, solar panels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skymoor.simulate.building.covers import fan, louvre, solar
from skymoor.simulate.building.kit import Kit, wall_colour
from skymoor.simulate.building.materials import Rng
from skymoor.simulate.building.roofs import Span, span_of
from skymoor.simulate.building.solids import ON_FLOOR, bars, boxes
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.mesh import Array, Label, Part, cylinder, inside, join, parallelograms, quads, stream
from skymoor.simulate.plan import Building


@dataclass(frozen=True)
class Tops:
    """Pages of what stands on a roof."""

    louvre: int
    fan: int
    solar: int


def rooftop(building: Building, kit: Kit, pages: Pages) -> Part:
    """Everything on the roof of a building, in the building's frame."""
    rng = stream(building.looks, "rooftop")
    tops = Tops(pages.add(louvre(rng), 0.02), pages.add(fan(rng), 0.02), pages.add(solar(rng), 0.02))
    if building.roof == "flat":
        return _on_flat(building, kit, tops, rng)
    if building.roof == "sawtooth":
        return join([])
    span = span_of(building)
    part = _on_pitch(building, span, kit, tops, rng)
    return part.placed(90.0, (0, 0, 0)) if span.turned else part


def _on_flat(building: Building, kit: Kit, tops: Tops, rng: Rng) -> Part:
    """Things of drawn kinds and sizes where there is room, in rows with the building."""
    outline = np.array(building.outline)
    low, high = outline.min(axis=0), outline.max(axis=0)
    x, y = outline.T
    area = abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))) / 2
    kinds = ["hvac", "hvac", "skylight", "vent", "vent", "duct", "mast", "cowl"]
    wished = ["stairs", "hvac", *rng.choice(kinds, min(26, max(3, round(area / rng.uniform(22, 45)))))]
    if rng.random() < 0.3:
        wished.insert(1, "solar")
    taken = np.zeros((0, 4))
    parts = []
    for kind in wished:
        size = _size(str(kind), rng)
        for _ in range(15):
            place = rng.uniform(low, high - size)
            box = np.concatenate([place, place + size])
            clash = (taken[:, :2] < box[2:] + 0.6) & (box[:2] - 0.6 < taken[:, 2:])
            if not clash.all(axis=1).any() and inside(outline, _rim(box, 0.9)).all():
                taken = np.vstack([taken, box])
                parts.append(_thing(str(kind), np.append(place, building.walls_m), size, building, kit, tops, rng))
                break
    return join(parts)


def _size(kind: str, rng: Rng) -> Array:
    spans = {
        "hvac": ((1.2, 1.0), (3.2, 2.0)),
        "skylight": ((1.0, 1.0), (2.4, 1.6)),
        "stairs": ((2.4, 2.6), (3.4, 4.0)),
        "duct": ((3.0, 0.5), (7.0, 0.8)),
        "solar": ((5.0, 3.5), (9.0, 6.0)),
    }
    size: Array = rng.uniform(*spans.get(kind, ((0.3, 0.3), (0.6, 0.6))))
    return size[::-1] if rng.random() < 0.4 and kind != "solar" else size


def _rim(box: Array, margin_m: float) -> Array:
    x0, y0, x1, y1 = box + margin_m * np.array([-1, -1, 1, 1])
    corners: Array = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [(x0 + x1) / 2, y0], [(x0 + x1) / 2, y1]])
    return corners


def _thing(kind: str, at: Array, size: Array, building: Building, kit: Kit, tops: Tops, rng: Rng) -> Part:
    if kind == "hvac":
        return _machine(at, size, kit, tops, rng)
    if kind == "skylight":
        return _skylight(at, size, kit)
    if kind == "stairs":
        return _stair_head(at, size, building, kit, rng)
    if kind == "duct":
        return _duct(at, size, kit, rng)
    if kind == "solar":
        return _panels(at, size, kit, tops)
    return _pipe(kind, at, kit, rng)


def _machine(at: Array, size: Array, kit: Kit, tops: Tops, rng: Rng) -> Part:
    """A box on rails, louvres on its long sides, one or two fans on top."""
    tint = np.array([0.45, 0.45, 0.43]) * rng.uniform(0.6, 1.1) * rng.uniform(0.94, 1.06, 3)
    tall = float(rng.uniform(0.9, 1.9))
    foot, top = at + [0, 0, 0.25], at + [size[0], size[1], 0.25 + tall]
    rails = boxes(
        [[at[0], at[1] + t * size[1], at[2]] for t in (0.1, 0.8)],
        [[at[0] + size[0], at[1] + (t + 0.1) * size[1], at[2] + 0.25] for t in (0.1, 0.8)],
        kit.grain,
        Label.OBJECT,
        0.5 * kit.metal,
        faces=ON_FLOOR,
    )
    body = boxes([foot], [top], kit.grain, Label.OBJECT, tint)
    x0, y0, z0 = foot
    wide = np.array([0.8 * size[0], 0, 0])
    grille = parallelograms(
        [[x0 + 0.1 * size[0], y0 - 0.01, z0 + 0.15], [x0 + 0.9 * size[0], top[1] + 0.01, z0 + 0.15]],
        [wide, -wide],
        [[0, 0, 0.65 * tall]],
        tops.louvre,
        Label.OBJECT,
        tint,
    )
    count = 2 if size[0] > 2.0 else 1
    parts = [rails, body, grille]
    for k in range(count):
        middle = foot + [size[0] * (k + 0.5) / count, size[1] / 2, tall]
        radius = 0.36 * min(size[0] / count, size[1])
        ring = cylinder(middle, radius, 0.16, kit.grain, Label.OBJECT, 0.8 * tint, facets=12)
        disc = parallelograms(
            [middle + [-radius, -radius, 0.02]], [[2 * radius, 0, 0]], [[0, 2 * radius, 0]], tops.fan, Label.OBJECT
        )
        scaled = Part(disc.corners, disc.uv / np.float32(2 * radius), disc.page, disc.label, disc.tint)
        parts += [ring, scaled]
    return join(parts)


def _skylight(at: Array, size: Array, kit: Kit) -> Part:
    """A curb with a low glass pyramid."""
    curb = boxes([at], [at + [size[0], size[1], 0.35]], kit.grain, Label.OBJECT, kit.metal, faces=ON_FLOOR)
    x0, y0, z = at + [0.06, 0.06, 0.35]
    x1, y1 = x0 + size[0] - 0.12, y0 + size[1] - 0.12
    base = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    peak = np.array([(x0 + x1) / 2, (y0 + y1) / 2, z + 0.35])
    faces = np.array([[base[k], base[(k + 1) % 4], peak, peak] for k in range(4)])
    glass = quads(faces, faces[..., :2] - base[0, :2] + 0.3, kit.rooms.page, Label.GLASS, (2.2, 2.2, 2.2))
    return join([curb, glass])


def _stair_head(at: Array, size: Array, building: Building, kit: Kit, rng: Rng) -> Part:
    """A small house over the stairs, with a door and a roof slab."""
    colour = wall_colour(building) * rng.uniform(0.8, 1.1)
    tall = float(rng.uniform(2.3, 2.8))
    body = boxes(
        [at],
        [at + [size[0], size[1], tall]],
        kit.infill if rng.random() < 0.5 else kit.grain,
        Label.WALL,
        colour / 0.5,
        faces=ON_FLOOR,
    )
    slab = boxes(
        [at + [-0.2, -0.2, tall]], [at + [size[0] + 0.2, size[1] + 0.2, tall + 0.15]], kit.grain, Label.ROOF, kit.stone
    )
    x = at[0] + 0.3 * size[0]
    door = boxes([[x, at[1] - 0.05, at[2] + 0.1]], [[x + 0.95, at[1], at[2] + 2.1]], kit.grain, Label.WALL, kit.door)
    return join([body, slab, door])


def _duct(at: Array, size: Array, kit: Kit, rng: Rng) -> Part:
    """A square duct on stands, with flanges."""
    long = int(size[1] > size[0])
    side = float(rng.uniform(0.35, 0.6))
    end = at + np.where(np.arange(3) == long, [size[0], size[1], 0], [side, side, 0]) + [0, 0, 0.4 + side]
    tint = np.array([0.46, 0.47, 0.48]) * rng.uniform(0.75, 1.05)
    body = boxes([at + [0, 0, 0.4]], [end], kit.grain, Label.OBJECT, tint)
    step = np.arange(0.2, size[long], 1.2)[:, None] * np.eye(3)[long]
    rims = boxes(
        at + [-0.03, -0.03, 0.37] + step,
        at + [side + 0.03, side + 0.03, 0.43 + side] - np.eye(3)[long] * (side - 0.03) + step,
        kit.grain,
        Label.OBJECT,
        0.8 * tint,
    )
    legs = boxes(at + step, at + step + [0.06, 0.06, 0.4], kit.grain, Label.OBJECT, 0.6 * tint, faces=ON_FLOOR)
    return join([body, rims, legs])


def _panels(at: Array, size: Array, kit: Kit, tops: Tops) -> Part:
    """Rows of solar panels, tilted."""
    rows = np.arange(0, size[1] - 1.0, 1.6)
    origin = at + np.column_stack([0 * rows, rows, 0 * rows + 0.2])
    face = parallelograms(origin, [[size[0], 0, 0]], [[0, 0.95, 0.3]], tops.solar, Label.OBJECT)
    back = parallelograms(
        origin + [size[0], 0.96, 0.29],
        [[-size[0], 0, 0]],
        [[0, -0.96, -0.29]],
        kit.grain,
        Label.OBJECT,
        (0.2, 0.2, 0.2),
    )
    posts = np.arange(0.2, size[0], 1.5)
    place = (origin[:, None, :] + np.column_stack([posts, 0 * posts + 0.85, 0 * posts])[None]).reshape(-1, 3)
    legs = bars(place - [0, 0, 0.2], place + [0, 0, 0.27], 0.05, kit.grain, Label.OBJECT, kit.metal)
    return join([face, back, legs])


def _pipe(kind: str, at: Array, kit: Kit, rng: Rng) -> Part:
    """A vent pipe, a cowl, or a mast with aerials."""
    tint = kit.metal * rng.uniform(0.7, 1.3)
    if kind == "mast":
        tall = float(rng.uniform(2.0, 4.5))
        arms = np.array([[at + [-0.5, 0, h * tall], at + [0.5, 0, h * tall]] for h in (0.75, 0.85, 0.95)])
        pole = cylinder(at, 0.035, tall, kit.grain, Label.OBJECT, tint, facets=6)
        return join([pole, bars(arms[:, 0], arms[:, 1], 0.02, kit.grain, Label.OBJECT, tint)])
    radius, tall = float(rng.uniform(0.06, 0.2)), float(rng.uniform(0.4, 1.1))
    parts = [cylinder(at, radius, tall, kit.grain, Label.OBJECT, tint, facets=9, cap=Label.OBJECT)]
    if kind == "cowl":
        parts.append(
            cylinder(
                at + [0, 0, tall + 0.06],
                1.8 * radius,
                0.2,
                kit.grain,
                Label.OBJECT,
                tint,
                facets=9,
                top_radius=0.3 * radius,
                cap=Label.OBJECT,
            )
        )
    return join(parts)


def _on_pitch(building: Building, span: Span, kit: Kit, tops: Tops, rng: Rng) -> Part:
    """Chimneys, roof windows, pipes and, on some, solar panels; the ridge runs along x."""
    parts = []
    reach = span.half_m - 1.0 if building.roof != "hip" else max(span.half_m - span.half_across_m, 1.0)

    def spot(share: float, side: float) -> tuple[Array, Array]:
        """A place on the slope and the slope's way up."""
        rise, run = span.rise_m, span.half_across_m + (span.overhang_m if building.roof == "hip" else 0.0)
        up = np.array([0.0, -side * run, rise])
        if building.roof == "shed":
            up = np.array([0.0, 2 * run, rise])
            side = -1.0
        foot = np.array([0.0, side * run, building.walls_m + 0.15])
        return foot + share * up, up / np.linalg.norm(up)

    if building.cover == "tiles" and building.roof != "shed":
        for _ in range(rng.integers(1, 3)):
            base, _ = spot(float(rng.uniform(0.7, 0.9)), float(rng.choice([-1, 1])))
            at = np.array([rng.uniform(-reach, reach), base[1], base[2] - 0.6])
            parts.append(_chimney(at, building.walls_m + span.rise_m + 1.0, kit))
    for _ in range(rng.integers(0, 6)):
        base, up = spot(float(rng.uniform(0.3, 0.6)), float(rng.choice([-1, 1])))
        parts.append(_roof_window(base + [rng.uniform(-reach, reach), 0, 0], up, kit))
    for _ in range(rng.integers(1, 5)):
        base, _ = spot(float(rng.uniform(0.2, 0.8)), float(rng.choice([-1, 1])))
        parts.append(_pipe("vent", base + [rng.uniform(-reach, reach), 0, -0.15], kit, rng))
    if rng.random() < 0.35:
        base, up = spot(0.3, float(rng.choice([-1, 1])))
        wide, tall = min(5.0, 1.2 * reach), min(3.2, 0.5 * span.half_across_m)
        along = np.array([wide, 0, 0]) * (1 if up[1] > 0 else -1)
        start = base - 0.5 * along + [0, 0, 0.12]
        parts.append(parallelograms([start], [along], [tall * up], tops.solar, Label.OBJECT))
    return join(parts)


def _chimney(at: Array, top: float, kit: Kit) -> Part:
    head = np.array([at[0] + 0.75, at[1] + 0.5, top])
    body = boxes([at], [head], kit.infill, Label.OBJECT, (0.85, 0.85, 0.85), faces=ON_FLOOR)
    cap = boxes([[at[0] - 0.06, at[1] - 0.06, top]], [head + [0.06, 0.06, 0.1]], kit.grain, Label.OBJECT, kit.stone)
    pots = [
        cylinder((at[0] + t, at[1] + 0.25, top + 0.1), 0.11, 0.3, kit.grain, Label.OBJECT, (0.25, 0.12, 0.08), facets=8)
        for t in (0.2, 0.55)
    ]
    return join([body, cap, *pots])


def _roof_window(at: Array, up: Array, kit: Kit) -> Part:
    """A window that lies in the slope, in a raised frame."""
    along = np.array([0.8, 0, 0]) * (1 if up[1] > 0 else -1)
    out = np.cross(along / 0.8, up)
    rim = np.array([[at, along, 1.2 * up], [at + 0.08 * along + 0.08 * up + 0.09 * out, 0.84 * along, 1.04 * up]])
    lifted = rim[0, 0] + 0.08 * out
    edges = [
        (rim[0, 0], along),
        (rim[0, 0] + along, 1.2 * up),
        (rim[0, 0] + along + 1.2 * up, -along),
        (rim[0, 0] + 1.2 * up, -1.2 * up),
    ]
    sides = parallelograms(
        [o for o, _ in edges], [a for _, a in edges], [0.08 * out] * 4, kit.grain, Label.OBJECT, 0.5 * kit.metal
    )
    frame = parallelograms([lifted], [along], [1.2 * up], kit.grain, Label.OBJECT, 0.6 * kit.metal)
    glass = parallelograms([rim[1, 0]], [rim[1, 1]], [rim[1, 2]], kit.rooms.page, Label.GLASS)
    return join([sides, frame, glass])
