# SPDX-License-Identifier: Apache-2.0
"""Walls of a levelled model, and pictures of them taken from straight in front."""

from skymoor.facade.counterpart import Counterpart, CounterpartOptions, counterparts
from skymoor.facade.picture import Facade, FacadeOptions, affine_between, facade_of, similarity_between
from skymoor.facade.sight import Relief, Sight, SightCheck, check_sight, relief_of, sight_of
from skymoor.facade.surface import Surface, surface_of
from skymoor.facade.walls import Wall, WallOptions, find_walls, moved_wall

__all__ = [
    "Counterpart",
    "CounterpartOptions",
    "Facade",
    "FacadeOptions",
    "Relief",
    "Sight",
    "SightCheck",
    "Surface",
    "Wall",
    "WallOptions",
    "affine_between",
    "check_sight",
    "counterparts",
    "facade_of",
    "find_walls",
    "moved_wall",
    "relief_of",
    "sight_of",
    "similarity_between",
    "surface_of",
]
