# SPDX-License-Identifier: Apache-2.0
"""Where the windows and doors of a building are: rectangles on its walls, no triangles yet.

A wall's own frame: x along it, to the right as seen from outside, y into the building, z up from the ground floor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skymoor.simulate.mesh import Array, stream
from skymoor.simulate.plan import Building

Kind = Literal["window", "shop", "glazed", "steel", "roller", "dock", "balcony", "blocked"]
Rng = np.random.Generator

FEW_SHARE = 0.2  # of the windows, which plain facades have
GLASS_EDGE_M = 0.17  # between panes and the borders of their bay and storey


@dataclass(frozen=True)
class Style:
    """A kind of window: its size, how it is divided, and what stands round it; metres."""

    width_m: float
    height_m: float
    sill_m: float
    columns: int
    transom: float  # share of the height above the bar that crosses the window; 0 is no bar
    frame_m: float
    recess_m: float
    sill_out_m: float
    head: Literal["none", "lintel", "surround"]
    tint: tuple[float, float, float]


@dataclass(frozen=True)
class Opening:
    """A rectangle x0, z0, x1, z1 in a wall."""

    kind: Kind
    x0: float
    z0: float
    x1: float
    z1: float
    recess_m: float
    style: Style

    @property
    def rect(self) -> tuple[float, float, float, float]:
        """x0, z0, x1, z1."""
        return self.x0, self.z0, self.x1, self.z1


def rects(openings: tuple[Opening, ...]) -> Array:
    """Rectangles (n, 4)."""
    return np.array([opening.rect for opening in openings], dtype=np.float64).reshape(-1, 4)


def wall_lengths(building: Building) -> Array:
    """Lengths (k,) of the walls; wall k runs from corner k to the next."""
    corners = np.array(building.outline)
    lengths: Array = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    return lengths


def role(building: Building, wall: int) -> Literal["front", "rear", "side"]:
    """The longest wall is the front, the next longest the rear."""
    rank = int(np.argsort(-wall_lengths(building), kind="stable").tolist().index(wall))
    return "front" if rank == 0 else "rear" if rank == 1 else "side"


def is_hall(building: Building) -> bool:
    """Whether it is a shed for work or goods, with gates instead of rows of windows."""
    return building.wall == "metal" or building.storey_m > 4.4


def styles(building: Building) -> tuple[Style, Style, Style]:
    """The windows of a building: upper storeys, ground floor, and small ones."""
    rng = stream(building.looks, "styles")
    frames = ((0.55, 0.55, 0.53), (0.045, 0.047, 0.05), (0.22, 0.23, 0.24), (0.16, 0.09, 0.05), (0.10, 0.15, 0.12))
    tint = frames[rng.integers(len(frames))]
    wide = building.wall in ("panels", "concrete") and rng.random() < 0.7
    height = min(float(rng.uniform(1.25, 1.75)), building.storey_m - 1.35)
    heads: tuple[Literal["none", "lintel", "surround"], ...] = ("none", "lintel", "surround")
    head = heads[rng.integers(3)] if building.wall in ("brick", "plaster") else "none"
    recess = float(rng.uniform(0.10, 0.20))
    upper = Style(
        width_m=float(rng.uniform(1.5, 2.6) if wide else rng.uniform(1.0, 1.5)),
        height_m=height,
        sill_m=float(rng.uniform(0.82, 0.98)),
        columns=int(rng.integers(2, 4)) if wide else int(rng.integers(1, 3)),
        transom=float(rng.choice([0.0, 0.28, 0.36])),
        frame_m=float(rng.uniform(0.05, 0.075)),
        recess_m=recess,
        sill_out_m=float(rng.uniform(0.08, 0.12)),
        head=head,
        tint=tint,
    )
    ground = replace(
        upper,
        width_m=float(rng.uniform(1.4, 2.2)),
        height_m=min(height + 0.25, building.storey_m - 1.1),
        sill_m=0.75,
        columns=int(rng.integers(2, 4)),
        transom=float(rng.choice([0.0, 0.3])),
    )
    small = Style(0.7, 0.8, 1.5, 1, 0.0, 0.05, recess, 0.08, "none", tint)
    return upper, ground, small


def openings_of(building: Building, wall: int) -> tuple[Opening, ...]:
    """All openings of one wall; none overlap, and all keep 0.3 m from each other and from the corners."""
    length = float(wall_lengths(building)[wall])
    if length < 3.0:
        return ()
    layout = _hall if is_hall(building) else _glazed if building.facade == "glass" else _storeys
    name = 0 if building.repeated else wall
    found = tuple(layout(building, role(building, wall), length, stream(building.looks, "openings", name)))
    if building.facade != "plain":
        return found
    few = stream(building.looks, "few windows", wall).random(len(found)) < FEW_SHARE
    return tuple(one for one, kept in zip(found, few, strict=True) if kept or one.kind not in ("window", "shop"))


def bays(building: Building, length: float, rng: Rng) -> Array:
    """Borders (n + 1,) of the bays of a wall: uneven, unless the bays repeat."""
    upper = styles(building)[0]
    wished = 5.2 if is_hall(building) else upper.width_m + stream(building.looks, "bays").uniform(0.8, 2.0)
    if building.repeated:
        return np.linspace(0.0, length, max(1, round(length / wished)) + 1)
    count = max(1, round((length - 1.0) / wished))
    widths = 1 + np.clip(rng.normal(0, 0.13, count), -0.3, 0.4)
    borders = np.concatenate([[0.0], np.cumsum(widths)])
    spread: Array = 0.5 + borders * ((length - 1.0) / borders[-1])
    return spread


def _storeys(building: Building, face: str, length: float, rng: Rng) -> Iterator[Opening]:
    """Rows of windows over a ground floor with doors, and shop windows in some fronts."""
    borders = bays(building, length, rng)
    n = len(borders) - 1
    plain = building.repeated
    shop = face == "front" and not plain and stream(building.looks, "shop").random() < 0.5
    entrance = n // 2 if plain else int(rng.integers(n))
    doors = {entrance: "glazed"} if face == "front" else {entrance: "steel"} if rng.random() < 0.7 and not plain else {}
    stairs = int(rng.integers(n)) if face != "front" and not plain and rng.random() < 0.45 else -1
    balconies = face == "front" and building.storeys > 2 and building.wall in ("brick", "plaster") and not plain
    kinds = rng.choice(
        ["main", "narrow", "double", "blank", "balcony"],
        n,
        p=[0.66, 0.08, 0.08, 0.06, 0.12] if balconies else [0.74, 0.10, 0.10, 0.06, 0.0],
    )
    for bay in range(n):
        for storey in range(building.storeys):
            column = "main" if plain else str(kinds[bay])
            if bay == stairs:
                column = "stairs"
            if storey == 0 and bay in doors:
                column = doors[bay]
            elif storey == 0 and shop and borders[bay + 1] - borders[bay] > 1.9:
                column = "shop"
            yield from _cell(building, column, (borders[bay], borders[bay + 1]), storey, rng)


def _glazed(building: Building, face: str, length: float, rng: Rng) -> Iterator[Opening]:
    """Panes from floor to floor and from bay to bay, a glazed door in the middle of the front."""
    style = replace(styles(building)[0], columns=2, transom=0.0, frame_m=0.05, sill_out_m=0.03, head="none")
    borders = bays(building, length, rng)
    borders[[0, -1]] += [0.2, -0.2]
    for bay in range(len(borders) - 1):
        middle, width = (borders[bay] + borders[bay + 1]) / 2, borders[bay + 1] - borders[bay] - 2 * GLASS_EDGE_M
        for storey in range(building.storeys):
            door = storey == 0 and face == "front" and bay == len(borders) // 2
            low = 0.0 if door else storey * building.storey_m + GLASS_EDGE_M
            tall = (storey + 1) * building.storey_m - 2 * GLASS_EDGE_M - low
            yield _opening("glazed" if door else "shop", middle, width, low, tall, style)


def _cell(building: Building, column: str, bay: tuple[float, float], storey: int, rng: Rng) -> Iterator[Opening]:
    """What one bay has in one storey."""
    upper, ground, small = styles(building)
    middle, room, floor = (bay[0] + bay[1]) / 2, bay[1] - bay[0] - 0.5, storey * building.storey_m
    style = ground if storey == 0 and column != "stairs" else upper
    if column in ("glazed", "steel"):
        width = min(1.9 if column == "glazed" else 1.0, room)
        yield _opening("glazed" if column == "glazed" else "steel", middle, width, 0.0, rng.uniform(2.1, 2.4), style)
        return
    if column == "shop":
        yield _opening("shop", middle, room, 0.35, min(2.9, building.storey_m - 0.6) - 0.35, style)
        return
    if column == "stairs":
        if storey + 1 < building.storeys:
            yield _opening("window", middle, min(1.2, room), floor + 0.5 * building.storey_m + 0.9, 1.3, small)
        return
    if column == "blank" or room < 0.6 or (not building.repeated and rng.random() < 0.035):
        return
    if column == "balcony" and storey > 0:
        yield _opening("balcony", middle, min(1.6, room), floor + 0.04, 2.2, style)
        return
    kind: Kind = "blocked" if not building.repeated and rng.random() < 0.045 else "window"
    shift = 0.0 if building.repeated or rng.random() > 0.12 else float(rng.uniform(-0.15, 0.15))
    if column == "narrow":
        yield _opening(kind, middle + shift, min(small.width_m, room), floor + 1.4, 0.9, small)
    elif column == "double" and room > 2.0:
        half = (room - 0.45) / 2
        for side in (-1, 1):
            yield _opening(kind, middle + side * (half + 0.45) / 2, half, floor + style.sill_m, style.height_m, style)
    else:
        width = min(style.width_m, room - 2 * abs(shift))
        yield _opening(kind, middle + shift, width, floor + style.sill_m, style.height_m, style)


def _hall(building: Building, face: str, length: float, rng: Rng) -> Iterator[Opening]:
    """Gates and docks below, a band of small windows under the eaves."""
    upper, _, small = styles(building)
    borders = bays(building, length, rng)
    gates = {"front": ["roller", "roller", "door", "none"], "rear": ["dock", "dock", "dock", "none"]}
    choice = gates.get(face, ["door", "none", "none", "none"])
    tall = min(4.2, building.walls_m - 1.0)
    high = building.walls_m - 1.9
    for bay in range(len(borders) - 1):
        own = stream(building.looks, "hall bay") if building.repeated else rng
        middle, room = (borders[bay] + borders[bay + 1]) / 2, borders[bay + 1] - borders[bay] - 0.7
        below, top = str(own.choice(choice)), 0.0
        if below == "roller":
            top = tall * float(own.uniform(0.8, 1.0))
            yield _opening("roller", middle, min(room, float(own.uniform(3.0, 4.2))), 0.0, top, upper)
        elif below == "dock" and tall > 3.4:
            top = 3.8
            yield _opening("dock", middle, min(room, 2.7), 1.1, min(2.7, tall - 1.1), upper)
        elif below == "door":
            top = 2.15
            yield _opening("steel", middle + float(own.uniform(-0.8, 0.8)), 1.0, 0.0, 2.15, upper)
        if high > top + 0.7 and (building.repeated or own.random() < 0.72):
            yield _opening("window", middle, min(room, float(own.uniform(2.0, 3.8))), high, 1.1, small)
        if not building.repeated and below == "none" and own.random() < 0.5 and high > 3.0:
            yield _opening("window", middle + float(own.uniform(-0.5, 0.5)), 1.6, 1.0, 1.3, upper)


def _opening(kind: Kind, middle: float, width: float, z0: float, height: float, style: Style) -> Opening:
    recess = {"roller": 0.9, "dock": 0.5, "blocked": 0.06, "shop": 0.18}.get(kind, style.recess_m)
    return Opening(kind, middle - width / 2, z0, middle + width / 2, z0 + height, recess, style)
