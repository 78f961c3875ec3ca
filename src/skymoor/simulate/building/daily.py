# SPDX-License-Identifier: Apache-2.0
"""What changes at a building from day to day: blinds, gates, bills, and what people leave before the walls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skymoor.simulate.building.clutter import Stuff, make_stuff, some_thing
from skymoor.simulate.building.doors import gate_leaf
from skymoor.simulate.building.facades import on_its_side
from skymoor.simulate.building.fittings import Free, room_on
from skymoor.simulate.building.kit import palette_of
from skymoor.simulate.building.materials import Array32, Rng, noise
from skymoor.simulate.building.openings import Opening, is_hall, openings_of, role, wall_lengths
from skymoor.simulate.building.solids import solid
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.mesh import Array, Label, Part, join, parallelograms, stream
from skymoor.simulate.plan import Building

Ground = Callable[[Array, Array], Array]


def day_things(building: Building, pages: Pages, day: str, ground: Ground) -> Part:
    """All that is of one day, in the building's frame; `ground` gives heights (n,) at x, y (n,) of that frame."""
    rng = stream(building.looks, "day", day)
    stuff = make_stuff(rng, pages)
    blinds = pages.add(_blinds(rng), 0.02)
    parts = []
    for wall, length in enumerate(wall_lengths(building)):
        own = stream(building.looks, "day", day, wall)
        openings = openings_of(building, wall)
        free = room_on(building, float(length), openings)
        things = [
            _shades(own, openings, blinds),
            *(_leaf(building, own, opening, stuff) for opening in openings if opening.kind in ("roller", "dock")),
            _bills(building, own, free, stuff),
        ]
        if building.water_up is None:
            things.append(_left(building, wall, own, openings, stuff, ground))
        parts.append(on_its_side(join(things), building, wall))
    return solid(join(parts))


def _shades(rng: Rng, openings: tuple[Opening, ...], page: int) -> Part:
    """Blinds drawn down by any share, and curtains at the sides, just behind the glass as one sees it."""
    glazed = [
        opening for opening in openings if opening.kind in ("window", "balcony") and opening.x1 - opening.x0 > 0.6
    ]
    origins, widths, heights, tints = [], [], [], []
    for opening in glazed:
        f, y = opening.style.frame_m, opening.recess_m - 0.008
        x0, x1, z0, z1 = opening.x0 + f, opening.x1 - f, opening.z0 + f, opening.z1 - f
        kind = rng.random()
        tone = np.array([0.36, 0.34, 0.30]) * rng.uniform(0.45, 1.15) * rng.uniform(0.93, 1.07, 3)
        if kind < 0.33:
            down = (z1 - z0) * float(rng.choice([0.15, 0.3, 0.5, 0.75, 1.0]))
            places = [(x0, z1 - down, x1, z1)]
        elif kind < 0.5:
            side = (x1 - x0) * float(rng.uniform(0.1, 0.3))
            places = [(x0, z0, x0 + side, z1), (x1 - side, z0, x1, z1)]
        else:
            continue
        for a, b, c, d in places:
            origins.append([a, y, b])
            widths.append([c - a, 0, 0])
            heights.append([0, 0, d - b])
            tints.append(tone)
    if not origins:
        return join([])
    return parallelograms(origins, widths, heights, page, Label.GLASS, np.repeat(np.array(tints), 1, axis=0))


def _leaf(building: Building, rng: Rng, opening: Opening, stuff: Stuff) -> Part:
    share = float(rng.choice([0.0, 0.25, 0.6, 0.97], p=[0.55, 0.1, 0.1, 0.25]))
    return gate_leaf(palette_of(building), stuff.grain, opening, share)


def _bills(building: Building, rng: Rng, free: Free, stuff: Stuff) -> Part:
    """Bills at the height of the eye, some crooked, some in rows; above the water of a flood."""
    level = 0.9 if building.water_up is None else max(0.9, building.water_up - building.up + 0.9)
    parts = []
    for _ in range(rng.poisson(free.length_m / 11)):
        tall = float(rng.uniform(0.4, 1.1))
        place = free.find(rng, (0.71 * tall, tall), (level, level + 0.7))
        if place is None:
            continue
        page = int(rng.choice(stuff.bills))
        sheet = parallelograms([[0, 0, 0]], [[0.71 * tall, 0, 0]], [[0, 0, tall]], page, Label.OBJECT)
        scale = np.float32(1.11 / tall)
        uv = np.clip(sheet.uv * scale, 0.01, None)
        x0, z0, _, _ = place
        parts.append(
            Part(sheet.corners + np.array([x0, -0.012, z0], np.float32), uv, sheet.page, sheet.label, sheet.tint)
        )
    return join(parts)


def _left(building: Building, wall: int, rng: Rng, openings: tuple[Opening, ...], stuff: Stuff, ground: Ground) -> Part:
    """Things before the wall, none before a door."""
    corners = np.array(building.outline)
    edge = corners[(wall + 1) % len(corners)] - corners[wall]
    length = float(np.linalg.norm(edge))
    along = edge / length
    out = np.array([along[1], -along[0]])
    doors = [opening for opening in openings if opening.kind in ("steel", "glazed", "roller", "dock")]
    taken = [(opening.x0 - 1.0, opening.x1 + 1.0) for opening in doors]
    busy = 4.5 if role(building, wall) != "front" else 6.0
    parts = []
    for _ in range(rng.poisson(length / busy)):
        part, width = some_thing(rng, stuff, hall=is_hall(building))
        if length < width + 2.4:
            continue
        x, off = float(rng.uniform(1.2 + width / 2, length - 1.2 - width / 2)), float(rng.uniform(0.65, 1.1))
        if any(a < x + width / 2 and x - width / 2 < b for a, b in taken):
            continue
        taken.append((x - width / 2, x + width / 2))
        place = corners[wall] + x * along + off * out
        z = float(ground(place[:1], place[1:])[0])
        parts.append(part.placed(float(rng.normal(0, 5)), (x, -off, z)))
    return join(parts)


def _blinds(rng: Rng) -> Array32:
    """Slats, half a metre of them, with soft shadows."""
    n = 50
    y = (np.arange(n)[:, None] + 0.5) / n
    shade = 0.82 + 0.12 * np.cos(2 * np.pi * 10 * y) + 0.06 * noise(rng, (n, n), 0.02, 0.4)
    return np.repeat(np.clip(shade, 0.3, 1)[..., None], 3, axis=2).astype(np.float32)
