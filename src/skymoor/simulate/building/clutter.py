# SPDX-License-Identifier: Apache-2.0
"""Things that people leave before walls: bins, boxes, pallets, bikes, planters, benches, cones.

Each stands on the origin, within a metre or so, its front towards -y.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skymoor.simulate.building.materials import Array32, Rng, centres, grain, joint, noise
from skymoor.simulate.building.signs import poster
from skymoor.simulate.building.solids import bars, boxes
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.mesh import Array, Label, Part, cylinder, join, parallelograms, triangles

_BINS = ((0.04, 0.075, 0.045), (0.05, 0.055, 0.06), (0.035, 0.05, 0.09), (0.12, 0.085, 0.05), (0.05, 0.075, 0.045))


@dataclass(frozen=True)
class Stuff:
    """Pages of the things of one day."""

    grain: int
    wood: int
    card: int
    bills: tuple[int, ...]


def make_stuff(rng: Rng, pages: Pages) -> Stuff:
    """Paint the day's pages."""
    bills = tuple(pages.add(poster(rng, (90, 64), 0.0125), 0.0125) for _ in range(5))
    return Stuff(pages.add(grain(rng), 0.02), pages.add(_wood(rng), 0.015), pages.add(_card(rng), 0.015), bills)


def some_thing(rng: Rng, stuff: Stuff, *, hall: bool) -> tuple[Part, float]:
    """A thing that suits an office or a hall, and how wide it is."""
    makers: list[tuple[Callable[[Rng, Stuff], Part], float]] = [
        (_bins, 2.0),
        (_cartons, 1.6),
        (_planter, 1.5),
        (_bikes, 2.4),
        (_bench, 1.8),
        (_board, 0.9),
        (_pallets, 1.4),
        (_container, 1.8),
        (_cones, 1.6),
        (_drums, 1.5),
    ]
    share = [1, 2, 0, 0.3, 0.2, 0, 4, 2, 1, 2] if hall else [3, 1.5, 3, 3, 1.5, 1, 0.7, 0.8, 0.6, 0]
    make, width = makers[rng.choice(len(makers), p=np.array(share) / np.sum(share))]
    return make(rng, stuff), width


def _bins(rng: Rng, stuff: Stuff) -> Part:
    parts = []
    for k in range(int(rng.integers(1, 4))):
        tint = np.array(_BINS[rng.integers(len(_BINS))]) * rng.uniform(0.7, 1.2)
        lid = np.array(_BINS[rng.integers(len(_BINS))])
        body = boxes([[-0.26, -0.3, 0.0]], [[0.26, 0.3, 0.92]], stuff.grain, Label.OBJECT, tint)
        top = boxes([[-0.29, -0.36, 0.92]], [[0.29, 0.34, 1.0]], stuff.grain, Label.OBJECT, lid)
        parts.append(join([body, top]).placed(float(rng.normal(0, 9)), (0.68 * k - 0.6, rng.normal(0, 0.06), 0)))
    return join(parts)


def _container(rng: Rng, stuff: Stuff) -> Part:
    tint = np.array(_BINS[rng.integers(len(_BINS))]) * rng.uniform(1.0, 2.2)
    body = boxes([[-0.7, -0.5, 0.15]], [[0.7, 0.5, 1.15]], stuff.grain, Label.OBJECT, tint)
    lid = boxes([[-0.74, -0.55, 1.15]], [[0.74, 0.5, 1.3]], stuff.grain, Label.OBJECT, 0.6 * tint)
    wheels = boxes(
        [[x, y, 0] for x in (-0.65, 0.5) for y in (-0.45, 0.35)],
        [[x + 0.15, y + 0.1, 0.16] for x in (-0.65, 0.5) for y in (-0.45, 0.35)],
        stuff.grain,
        Label.OBJECT,
        (0.03, 0.03, 0.03),
    )
    return join([body, lid, wheels])


def _cartons(rng: Rng, stuff: Stuff) -> Part:
    parts = []
    tops = np.zeros(3)
    for _ in range(int(rng.integers(2, 7))):
        column = int(rng.integers(3))
        size = rng.uniform((0.3, 0.25, 0.2), (0.55, 0.45, 0.45))
        tint = np.array([0.33, 0.235, 0.145]) * rng.uniform(0.75, 1.2)
        block = boxes([-size / 2 * [1, 1, 0]], [size * [0.5, 0.5, 1]], stuff.card, Label.OBJECT, tint / 0.9)
        parts.append(block.placed(float(rng.normal(0, 12)), (0.55 * (column - 1), rng.normal(0, 0.05), tops[column])))
        tops[column] += size[2]
    return join(parts)


def _pallets(rng: Rng, stuff: Stuff) -> Part:
    parts = []
    count = int(rng.integers(1, 9))
    beams = np.array([[-0.6, y, 0.0] for y in (-0.4, -0.05, 0.3)])
    boards = np.array([[x, -0.4, 0.1] for x in np.linspace(-0.6, 0.48, 6)])
    for k in range(count):
        tint = np.array([0.30, 0.23, 0.15]) * rng.uniform(0.6, 1.2)
        pallet = join(
            [
                boxes(beams, beams + [1.2, 0.1, 0.1], stuff.wood, Label.OBJECT, 0.8 * tint),
                boxes(boards, boards + [0.12, 0.8, 0.03], stuff.wood, Label.OBJECT, tint),
            ]
        )
        parts.append(pallet.placed(float(rng.normal(0, 2)), (rng.normal(0, 0.02), rng.normal(0, 0.02), 0.144 * k)))
    if rng.random() < 0.5:
        tint = np.array([0.33, 0.3, 0.25]) * rng.uniform(0.4, 1.3)
        load = boxes([[-0.55, -0.36, 0]], [[0.55, 0.36, rng.uniform(0.4, 1.1)]], stuff.card, Label.OBJECT, tint)
        parts.append(load.placed(float(rng.normal(0, 2)), (0, 0, 0.144 * count)))
    return join(parts)


def _bikes(rng: Rng, stuff: Stuff) -> Part:
    bikes = [
        _bike(rng, stuff).placed(float(90 + rng.normal(0, 6)), (0.55 * k - 0.8, -0.4, 0))
        for k in range(int(rng.integers(1, 5)))
    ]
    stand = np.array([[[x, -0.1, 0], [x, -0.1, 0.75]] for x in (-1.1, 1.1)] + [[[-1.1, -0.1, 0.75], [1.1, -0.1, 0.75]]])
    return join([*bikes, bars(stand[:, 0], stand[:, 1], 0.05, stuff.grain, Label.OBJECT, (0.35, 0.36, 0.37))])


def _bike(rng: Rng, stuff: Stuff) -> Part:
    """Two wheels and a frame of bars, along x."""
    tint = rng.uniform(0.04, 0.25) * rng.uniform(0.7, 1.3, 3)
    turn = np.linspace(0, 2 * np.pi, 13)
    ring = np.column_stack([0.33 * np.cos(turn), 0 * turn, 0.33 + 0.33 * np.sin(turn)])
    rims = [
        bars(ring[:-1] + [x, 0, 0], ring[1:] + [x, 0, 0], 0.035, stuff.grain, Label.OBJECT, (0.03, 0.03, 0.03))
        for x in (-0.52, 0.52)
    ]
    hub, seat, crank, head = (-0.52, 0, 0.33), (-0.22, 0, 0.85), (-0.08, 0, 0.3), (0.36, 0, 0.82)
    fork, bar0, bar1 = (0.52, 0, 0.33), (0.36, -0.28, 0.98), (0.36, 0.28, 0.98)
    pairs = np.array(
        [
            (hub, seat),
            (hub, crank),
            (crank, seat),
            (crank, head),
            (seat, head),
            (head, fork),
            (head, (0.36, 0, 0.98)),
            (bar0, bar1),
        ]
    )
    saddle = boxes([[-0.36, -0.07, 0.9]], [[-0.1, 0.07, 0.96]], stuff.grain, Label.OBJECT, (0.04, 0.04, 0.04))
    return join([*rims, bars(pairs[:, 0], pairs[:, 1], 0.035, stuff.grain, Label.OBJECT, tint), saddle])


def _planter(rng: Rng, stuff: Stuff) -> Part:
    tint = np.array([[0.33, 0.32, 0.30], [0.22, 0.15, 0.10], [0.09, 0.09, 0.09]])[rng.integers(3)]
    wide = float(rng.uniform(0.5, 1.2))
    tub = boxes([[-wide / 2, -0.25, 0]], [[wide / 2, 0.25, 0.5]], stuff.grain, Label.OBJECT, tint)
    return join([tub, leaves(rng, stuff.grain, np.array([0, 0, 0.75]), np.array([wide / 2, 0.28, 0.38]), 160)])


def leaves(rng: Rng, page: int, middle: Array, half: Array, count: int) -> Part:
    """A bush: small triangles that fill an ellipsoid."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    places = middle + direction * half * rng.random((count, 1)) ** (1 / 3)
    corners = places[:, None, :] + rng.normal(0, 0.07, (count, 3, 3))
    tint = np.array([0.055, 0.10, 0.03]) * rng.uniform(0.5, 1.5, (count, 1)) * rng.uniform(0.85, 1.2, (count, 3))
    return triangles(corners, rng.random((count, 3, 2)), page, Label.PLANT, tint)


def _bench(rng: Rng, stuff: Stuff) -> Part:
    tint = np.array([0.24, 0.16, 0.09]) * rng.uniform(0.6, 1.2)
    slats = np.array([[-0.8, y, 0.42] for y in (-0.22, -0.07, 0.08)] + [[-0.8, 0.22, 0.62], [-0.8, 0.22, 0.77]])
    size = np.array([[1.6, 0.12, 0.04]] * 3 + [[1.6, 0.03, 0.1]] * 2)
    legs = np.array([[x, -0.2, 0.0] for x in (-0.7, 0.62)])
    return join(
        [
            boxes(slats, slats + size, stuff.wood, Label.OBJECT, tint),
            boxes(legs, legs + [0.08, 0.45, 0.42], stuff.grain, Label.OBJECT, (0.07, 0.07, 0.07)),
        ]
    )


def _board(rng: Rng, stuff: Stuff) -> Part:
    """Two boards that lean against each other, a bill on the front one."""
    page = stuff.bills[rng.integers(len(stuff.bills))]
    front = parallelograms([[-0.4, -0.3, 0.05]], [[0.8, 0, 0]], [[0, 0.28, 1.05]], page, Label.OBJECT)
    back = parallelograms(
        [[0.4, 0.28, 0.05]], [[-0.8, 0, 0]], [[0, -0.28, 1.05]], stuff.grain, Label.OBJECT, (0.1, 0.1, 0.1)
    )
    return join([front, back])


def _cones(rng: Rng, stuff: Stuff) -> Part:
    orange = np.array([0.42, 0.12, 0.03]) * rng.uniform(0.6, 1.0)
    parts = []
    for k in range(int(rng.integers(1, 4))):
        at = np.array([0.6 * k - 0.6, rng.normal(0, 0.2), 0.0])
        parts += [
            boxes([at - [0.18, 0.18, 0]], [at + [0.18, 0.18, 0.04]], stuff.grain, Label.OBJECT, 0.6 * orange),
            cylinder(at, 0.13, 0.6, stuff.grain, Label.OBJECT, orange, facets=10, top_radius=0.03),
            cylinder(
                at + [0, 0, 0.24], 0.099, 0.12, stuff.grain, Label.OBJECT, (0.5, 0.5, 0.48), facets=10, top_radius=0.077
            ),
        ]
    return join(parts)


def _drums(rng: Rng, stuff: Stuff) -> Part:
    parts = []
    for k in range(int(rng.integers(1, 4))):
        tint = np.array(_BINS[rng.integers(len(_BINS))]) * rng.uniform(1.0, 2.5)
        at = (0.65 * k - 0.6, float(rng.normal(0, 0.1)), 0.0)
        parts.append(cylinder(at, 0.29, 0.88, stuff.grain, Label.OBJECT, tint, facets=14, cap=Label.OBJECT))
    return join(parts)


def _wood(rng: Rng) -> Array32:
    shape = (64, 64)
    y, _ = centres(shape, 0.015)
    shade = 0.85 + 0.1 * noise(rng, shape, 0.015, (0.02, 0.3)) - 0.5 * joint(y, 0.24, 0.012, 0.015)
    return np.repeat(np.clip(shade, 0.2, 1)[..., None], 3, axis=2)


def _card(rng: Rng) -> Array32:
    """Cardboard with a strip of tape and a label here and there."""
    shape = (72, 72)
    shade = 0.88 + 0.04 * noise(rng, shape, 0.015, 0.15)
    shade[20:24] = 0.98
    shade[50:60, 12:28] = 1.0
    shade[53:55, 14:26] = 0.3
    return np.repeat(np.clip(shade, 0.2, 1)[..., None], 3, axis=2)
