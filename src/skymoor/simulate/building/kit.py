# SPDX-License-Identifier: Apache-2.0
"""Pages and colours that all parts of one building share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skymoor.simulate.building.interiors import Rooms, paint_rooms
from skymoor.simulate.building.materials import COLOURS, grain, wall_texture
from skymoor.simulate.building.openings import wall_lengths
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.mesh import Array, stream
from skymoor.simulate.plan import Building

PAGES_BYTES = 13.0e6
"""What the walls and the roof of one building may take, with their mip levels."""

BELOW_M = 1.2
"""Walls are painted down to this much under the ground floor; below, their last row goes on."""

_DOORS = ((0.10, 0.13, 0.16), (0.20, 0.21, 0.22), (0.07, 0.11, 0.08), (0.22, 0.07, 0.05), (0.36, 0.35, 0.32))
_GATES = ((0.42, 0.43, 0.43), (0.30, 0.32, 0.34), (0.13, 0.18, 0.25), (0.33, 0.28, 0.20))
_STONES = ((0.42, 0.40, 0.36), (0.34, 0.33, 0.31), (0.50, 0.47, 0.41), (0.25, 0.25, 0.25))
_METALS = ((0.33, 0.34, 0.35), (0.14, 0.14, 0.14), (0.45, 0.45, 0.44), (0.20, 0.13, 0.09))


@dataclass(frozen=True)
class Palette:
    """Colours of a building's details; linear albedo (3,)."""

    stone: Array  # sills, lintels, steps
    metal: Array  # gutters, pipes, flashings
    door: Array
    gate: Array


@dataclass(frozen=True)
class Kit(Palette):
    """The colours, and the pages that all parts of a building share."""

    grain: int
    infill: int  # other bricks or plaster, in openings that were closed
    rooms: Rooms


def wall_colour(building: Building) -> Array:
    """Linear albedo (3,) of the walls, before dirt."""
    rng = stream(building.looks, "colour")
    choices = COLOURS[building.wall]
    colour: Array = np.array(choices[rng.integers(len(choices))]) * rng.uniform(0.88, 1.1) * rng.uniform(0.97, 1.03, 3)
    return np.clip(colour, 0.05, 0.62)


def palette_of(building: Building) -> Palette:
    """Choose the colours."""
    rng = stream(building.looks, "palette")

    def pick(choices: tuple[tuple[float, float, float], ...]) -> Array:
        chosen: Array = np.array(choices[rng.integers(len(choices))]) * rng.uniform(0.85, 1.1)
        return chosen

    return Palette(stone=pick(_STONES), metal=pick(_METALS), door=pick(_DOORS), gate=pick(_GATES))


def make_kit(building: Building, pages: Pages) -> Kit:
    """Choose the colours and paint the shared pages."""
    rng = stream(building.looks, "kit")
    colours = palette_of(building)
    other = "brick" if building.wall in ("brick", "plaster") else "concrete"
    infill = wall_texture(other, rng, (110, 150), 0.02, wall_colour(building) * rng.uniform(0.7, 1.2))
    grain_page, infill_page = pages.add(grain(rng), 0.02), pages.add(np.clip(infill, 0, 0.7), 0.02)
    rooms = paint_rooms(rng, pages)
    if building.facade == "glass":
        pages.coated.add(rooms.page)
    return Kit(
        stone=colours.stone,
        metal=colours.metal,
        door=colours.door,
        gate=colours.gate,
        grain=grain_page,
        infill=infill_page,
        rooms=rooms,
    )


def texel_m(building: Building, top_m: float) -> float:
    """Texels of 2 cm on the walls (3 cm on the roof), or larger ones where a building would take too much memory."""
    if building.repeated:
        return 0.02
    corners = np.array(building.outline)
    walls = float(wall_lengths(building).sum()) * (top_m + BELOW_M)
    roof = float(np.prod(corners.max(axis=0) - corners.min(axis=0))) * (1.2 if building.roof == "flat" else 1.45)
    return max(0.02, float(np.sqrt((walls + roof / 2.25) * 16 / 3 / PAGES_BYTES)))
