# SPDX-License-Identifier: Apache-2.0
"""What somebody knows before the search: the area, the compass heading of a photo, the flying height."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.match.propose import ALL_AZIMUTHS
from skymoor.types import Camera

HEIGHT_TOLERANCE = 1.25
"""Ratio to either side of a flying height that is stated: it varies with the ground, and is told as a round number."""
KEYS = ("area", "near", "heading", "height")
LARGEST = 1e9  # of any number that is stated; whole ones of TOML have no end


@dataclass(frozen=True)
class Heading:
    """The compass direction, degrees clockwise from north, in which a photo looks; of one that looks straight down,
    that of its upper edge. `image` is the end of the photo's name, empty for the first; right within `tolerance_deg`.
    """

    degrees: float
    image: str = ""
    tolerance_deg: float = 20.0

    @classmethod
    def parsed(cls, text: str, where: str = "--heading") -> Heading:
        """Of "240" or "DJI_0042.JPG=240". Raises `InputError` for anything else."""
        image, _, number = text.rpartition("=")
        try:
            degrees = float(number)
        except ValueError:
            degrees = float("nan")
        if not -360 <= degrees <= 360:
            raise InputError(
                f"{where} {text}: give degrees clockwise from north, of the first photo or as PHOTO=DEGREES"
            )
        return cls(degrees % 360, image)

    def azimuths(self, cameras: Sequence[Camera]) -> tuple[float, float]:
        """Middle and half width, in radians, of the azimuths of the cameras' level frame that are left.

        All of them where the photo is not among the cameras.
        """
        named = sorted((one for one in cameras if one.image.endswith(self.image)), key=lambda one: one.image)
        if not named:
            return ALL_AZIMUTHS
        return float(np.radians(self.degrees)) - own_azimuth(named[0]), float(np.radians(self.tolerance_deg))


def own_azimuth(camera: Camera) -> float:
    """The direction, radians clockwise from y, in which a photo looks in the level frame of its camera."""
    # The rows of the rotation are the camera's axes: right, down and forward. Whatever the tilt, forward and the upper
    # edge point to the same side.
    rotation = camera.cam_from_world.rotation
    east, north, _ = rotation[2] - rotation[1]
    return float(np.arctan2(east, north))


@dataclass(frozen=True)
class SearchPrior:
    """What bounds the search; nothing does by itself.

    `area` is west, south, east and north in degrees; `height_m` the flying height above the ground.
    """

    area: tuple[float, float, float, float] | None = None
    heading: Heading | None = None
    height_m: float | None = None

    @classmethod
    def of(
        cls,
        area: Sequence[float] | None = None,
        near: Sequence[float] | None = None,
        heading: str | float | None = None,
        height: float | None = None,
        where: str = "--",
    ) -> SearchPrior:
        """From what a user states; `near` is latitude, longitude and a radius in metres.

        Raises `InputError`, naming what is wrong with `where` before it.
        """
        if area is not None and near is not None:
            raise InputError(f"{where}area and {where}near both bound the area; give one of them")
        box = _box(area, f"{where}area") if near is None else _around(near, f"{where}near")
        if height is not None and not 0 < height < np.inf:
            raise InputError(f"{where}height {height:g}: give the flying height above the ground, in metres")
        known = None if heading is None else Heading.parsed(str(heading), f"{where}heading")
        return cls(box, known, height)

    def overruled(self, other: SearchPrior) -> SearchPrior:
        """This one, where the other states nothing."""
        return SearchPrior(other.area or self.area, other.heading or self.heading, other.height_m or self.height_m)

    def options(self) -> dict[str, object]:
        """The options that a stated flying height sets."""
        if self.height_m is None:
            return {}
        low, high = self.height_m / HEIGHT_TOLERANCE, self.height_m * HEIGHT_TOLERANCE
        return {"match.min_height_m": low, "match.max_height_m": high}


@dataclass(frozen=True)
class Person:
    """What a person stated after a refusal: the prior that follows from it, and the record of who said what."""

    prior: SearchPrior
    record: dict[str, Any] = field(default_factory=dict)


def plain_prior(prior: SearchPrior) -> dict[str, Any]:
    """For JSON; `prior_from_plain` reads it."""
    return asdict(prior)


def prior_from_plain(value: Mapping[str, Any]) -> SearchPrior:
    """Of `plain_prior`. Raises `KeyError`, `TypeError` or `ValueError` for anything else."""
    area, heading = value["area"], value["heading"]
    return SearchPrior(
        None if area is None else _box(area, "area"),
        None if heading is None else Heading(**heading),
        value["height_m"],
    )


def prior_from_table(table: Mapping[str, object], where: str) -> SearchPrior:
    """Of the table [prior] of a site.toml, whose keys are `KEYS`. Raises `InputError`."""
    for key, count in (("area", 4), ("near", 3)):
        value = table.get(key)
        if value is not None and not (isinstance(value, list) and len(value) == count and all(map(_is_number, value))):
            raise InputError(f"{where}: prior.{key} = {value!r} must be a list of {count} numbers")
    if "height" in table and not _is_number(table["height"]):
        raise InputError(f"{where}: prior.height = {table['height']!r} must be a number of metres")
    return SearchPrior.of(**dict(table), where=f"{where}: prior.")  # type: ignore[arg-type]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST


def _box(area: Sequence[float] | None, name: str) -> tuple[float, float, float, float] | None:
    if area is None:
        return None
    west, south, east, north = (float(value) for value in area)
    if not (-180 <= west < east <= 180 and -90 <= south < north <= 90):
        raise InputError(
            f"{name} {west:g} {south:g} {east:g} {north:g}: give west, south, east and north in degrees, "
            "with west below east and south below north"
        )
    return west, south, east, north


def _around(near: Sequence[float], name: str) -> tuple[float, float, float, float]:
    lat, lon, radius = (float(value) for value in near)
    if not (abs(lat) < 90 and abs(lon) <= 180 and 0 < radius < 1e6):
        raise InputError(f"{name} {lat:g} {lon:g} {radius:g}: give latitude, longitude and a radius in metres")
    corners = EnuFrame(lat, lon, 0.0).lla_from_enu([[-radius, -radius, 0.0], [radius, radius, 0.0]])
    (south, west, _), (north, east, _) = corners.tolist()
    return west, south, east, north
