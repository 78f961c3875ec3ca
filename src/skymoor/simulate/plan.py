# SPDX-License-Identifier: Apache-2.0
"""The nouns of a simulated site: days, buildings, roads and yards. Plain data, no triangles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skymoor.geo import EnuFrame
from skymoor.simulate.mesh import stream
from skymoor.simulate.options import SiteOptions

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

Season = Literal["summer", "autumn", "winter"]
SEASONS: tuple[Season, ...] = ("summer", "autumn", "winter")
SUN_UP_DEG = {"summer": (25.0, 45.0), "autumn": (18.0, 32.0), "winter": (14.0, 24.0)}  # morning or afternoon

Facade = Literal["windows", "glass", "plain"]


@dataclass(frozen=True)
class Date:
    """A day: where the sun stands, how the plants look, and the seed of all that moves from day to day."""

    name: str
    season: Season
    sun_azimuth_deg: float
    sun_elevation_deg: float
    haze: float = 0.0

    @property
    def sun(self) -> Array:
        """Unit vector (3,) towards the sun, east-north-up."""
        azimuth, elevation = np.radians([self.sun_azimuth_deg, self.sun_elevation_deg])
        plan = np.cos(elevation)
        return np.array([np.sin(azimuth) * plan, np.cos(azimuth) * plan, np.sin(elevation)])


@dataclass(frozen=True)
class Building:
    """A building with upright walls over a rectilinear outline.

    Attributes:
        name: says which one it is.
        east, north, up: of its middle, and of its ground floor.
        heading_deg: its own x axis, counter-clockwise from east.
        outline: (x, y) metres about its middle, counter-clockwise.
        storeys, storey_m: number and height; walls are the product of both high.
        roof: pitched roofs only stand on rectangles.
        wall, cover: materials of the walls and of the roof.
        looks: seed of everything random about it; buildings of equal looks and outline are twins.
        fine: windows and doors are modelled and textures fine; otherwise they are painted, coarsely.
        repeated: each bay of a facade looks like the next.
        water_up: level of the water that it stands in.
        facade: "glass" is glazed from floor to floor and reflects, "plain" has few windows.
    """

    name: str
    east: float
    north: float
    up: float
    heading_deg: float
    outline: tuple[tuple[float, float], ...]
    storeys: int
    storey_m: float
    roof: Literal["flat", "gable", "hip", "shed", "sawtooth"]
    wall: Literal["brick", "plaster", "concrete", "metal", "panels"]
    cover: Literal["membrane", "gravel", "tiles", "metal"]
    looks: int
    fine: bool = True
    repeated: bool = False
    water_up: float | None = None
    facade: Facade = "windows"

    @property
    def walls_m(self) -> float:
        """Height of the walls."""
        return self.storeys * self.storey_m

    @property
    def outline_enu(self) -> Array:
        """The outline (k, 2) east, north."""
        c, s = np.cos(np.radians(self.heading_deg)), np.sin(np.radians(self.heading_deg))
        placed: Array = np.array(self.outline) @ [[c, s], [-s, c]] + [self.east, self.north]
        return placed


@dataclass(frozen=True)
class Strip:
    """A road or a path: a polyline (k, 2) with a width."""

    line: tuple[tuple[float, float], ...]
    width_m: float
    kind: Literal["road", "path", "rail"]


@dataclass(frozen=True)
class Yard:
    """A paved rectangle: a car park with bays, or a concrete yard."""

    east: float
    north: float
    heading_deg: float
    length_m: float
    width_m: float
    kind: Literal["parking", "concrete"]


@dataclass(frozen=True)
class Dates:
    """The three days on which a site is looked at."""

    airborne: Date
    ground: Date
    satellite: Date


# Suburbs of middle latitudes on all sides of the Earth, west and east of their UTM zone's middle.
PLACES_DEG = (
    (39.04, -77.49),
    (44.06, -123.02),
    (53.83, -1.58),
    (52.40, 13.05),
    (43.58, 1.42),
    (35.71, 139.48),
    (-37.87, 145.12),
    (-43.55, 172.56),
    (-31.38, -64.22),
    (-25.86, 28.19),
)


def place_of(options: SiteOptions) -> EnuFrame:
    """Where on Earth the site stands: the origin of its frame, drawn from its seed."""
    rng = stream(options.key, "place")
    lat, lon = np.array(PLACES_DEG[int(rng.integers(len(PLACES_DEG)))]) + rng.uniform(-0.05, 0.05, 2)
    # Numbers that survive being written down.
    return EnuFrame(round(float(lat), 7), round(float(lon), 7), round(float(rng.uniform(20.0, 300.0)), 3))


def dates_of(options: SiteOptions) -> Dates:
    """A summer's morning in the air, its afternoon on the ground, and an autumn or winter's day from space.

    Under real conditions months lie between air and ground, and the sun on the ground stands east or west.
    """
    rng = stream(options.key, "dates")
    southern = place_of(options).lat_deg < 0

    def sun(azimuth: tuple[float, float], elevation: tuple[float, float]) -> tuple[float, float]:
        azimuth_deg, elevation_deg = float(rng.uniform(*azimuth)), float(rng.uniform(*elevation))
        # South of the equator the sun passes through the north.
        return ((180.0 - azimuth_deg) % 360.0 if southern else azimuth_deg), elevation_deg

    season: Season = "winter" if rng.uniform() < 0.4 else "autumn"
    dates = Dates(
        airborne=Date("airborne", "summer", *sun((130.0, 170.0), (45.0, 58.0)), haze=0.0003),
        ground=Date("ground", "summer", *sun((220.0, 260.0), (25.0, 40.0)), haze=0.0003),
        satellite=Date("satellite", season, *sun((150.0, 210.0), (28.0, 45.0))),
    )
    if not options.real:
        return dates
    later = SEASONS[int(rng.integers(len(SEASONS)))]
    side = ((105.0, 150.0), (210.0, 255.0))[int(rng.integers(2))]
    ground = Date("ground", later, *sun(side, SUN_UP_DEG[later]), haze=0.0003)
    flown: Season = "summer" if later != "summer" else "autumn"
    airborne = (
        dates.airborne if flown == "summer" else Date("airborne", flown, *sun((140.0, 200.0), (28.0, 40.0)), 3e-4)
    )
    return replace(dates, airborne=airborne, ground=ground)
