# SPDX-License-Identifier: Apache-2.0
"""Coordinates of control as files have them, and what they are on Earth with which accuracy."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, isnan, nan
from pathlib import Path

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from skymoor.control import Place
from skymoor.errors import InputError
from skymoor.geo.accuracy import CE90_PER_SIGMA, LE90_PER_SIGMA
from skymoor.geo.datum import ellipsoidal_heights, horizontal_part, vertical_datum_of

LONLAT = "EPSG:4326"
UTM = re.compile(r"WGS\s?84\s+UTM\s+(?:zone\s+)?(\d{1,2})\s*([NS])", re.IGNORECASE)
NO_PLACE = "has no coordinates; give lat,lon,height, or x,y,z with control.crs"


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of each horizontal axis and of the height, metres; None where they are not stated."""

    sigma_h: float | None = None
    sigma_v: float | None = None


@dataclass(frozen=True)
class Stated:
    """What is stated of all control, for what the files do not say: CRS of x, y, z, datum of heights, CE90 and LE90."""

    crs: str | None = None
    vertical_datum: str | None = None
    ce90: float | None = None
    le90: float | None = None

    @property
    def accuracy(self) -> Accuracy:
        """As standard deviations."""
        return Accuracy(
            None if self.ce90 is None else self.ce90 / CE90_PER_SIGMA,
            None if self.le90 is None else self.le90 / LE90_PER_SIGMA,
        )


@dataclass(frozen=True)
class Row:
    """Coordinates of one line: x east or longitude, y north or latitude, z NaN where only the plan is known."""

    x: float
    y: float
    z: float
    crs: str | None
    accuracy: Accuracy
    where: str

    def same_place(self, other: Row) -> bool:
        """Whether another line has the same coordinates."""
        heights = (isnan(self.z) and isnan(other.z)) or self.z == other.z
        return (self.x, self.y) == (other.x, other.y) and heights


@dataclass(frozen=True)
class Coordinates:
    """Which columns of a table have the coordinates, and which the accuracy."""

    x: str
    y: str
    z: str | None
    crs: str | None
    accuracy: tuple[str, ...]

    @classmethod
    def of_table(cls, path: Path, header: Sequence[str], *, required: bool) -> Coordinates | None:
        """By the names of the columns; None where there are none of coordinates. Raises `InputError`."""
        accuracy = tuple(name for name in ("sigma_h", "sigma_v", "ce90", "le90") if name in header)
        if {"sigma_h", "ce90"} <= set(accuracy) or {"sigma_v", "le90"} <= set(accuracy):
            raise InputError(f"{path}: has the accuracy twice, as sigma and as CE90 or LE90; keep one of them")
        if {"lat", "lon"} <= set(header):
            return cls("lon", "lat", "height" if "height" in header else None, LONLAT, accuracy)
        if {"x", "y"} <= set(header):
            return cls("x", "y", "z" if "z" in header else None, None, accuracy)
        if required or {"lat", "lon", "x", "y"} & set(header):
            raise InputError(f"{path}: {NO_PLACE}")
        return None

    def row(self, cells: Mapping[str, str], where: str) -> Row | None:
        """The coordinates of a line; None where its cells are empty."""
        if not cells[self.x] and not cells[self.y]:
            return None
        x, y = (number_of(cells[name], name, where) for name in (self.x, self.y))
        z = nan if self.z is None or not cells[self.z] else number_of(cells[self.z], self.z, where, may_be_nan=True)
        given = {name: number_of(cells[name], name, where) for name in self.accuracy if cells[name]}
        for name, value in given.items():
            if value <= 0:
                raise InputError(f"{where}: {name} = {value:g} must be metres above zero")
        horizontal = given.get("sigma_h", given["ce90"] / CE90_PER_SIGMA if "ce90" in given else None)
        vertical = given.get("sigma_v", given["le90"] / LE90_PER_SIGMA if "le90" in given else None)
        return Row(x, y, z, self.crs, Accuracy(horizontal, vertical), where)


def number_of(text: str, name: str, where: str, *, may_be_nan: bool = False) -> float:
    """A number, or `InputError`."""
    try:
        number = float(text)
    except ValueError:
        raise InputError(f"{where}: {name} = {text[:100]!r} is not a number") from None
    if not isfinite(number) and not (may_be_nan and isnan(number)):
        raise InputError(f"{where}: {name} = {text} must be a finite number")
    return number


def crs_of(text: str, where: str, otherwise: str = "") -> str:
    """A CRS as pyproj takes it, also of ODM's form WGS84 UTM 32N. Raises `InputError`."""
    utm = UTM.fullmatch(text.strip())
    code = f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}" if utm else text.strip()
    try:
        CRS.from_user_input(code)
    except CRSError:
        more = f"; {otherwise}" if otherwise else ""
        raise InputError(f"{where}: {text[:200]!r} is no CRS that PROJ knows{more}") from None
    return code


def places_of(rows: Sequence[Row], stated: Stated) -> list[Place]:
    """Positions on Earth of coordinates. Raises `InputError`, naming file and line, for what is not on it, and for what
    is not stated: a CRS, the vertical datum of heights, the accuracy."""
    return [_place(row, stated) for row in rows]


def _place(row: Row, stated: Stated) -> Place:
    code = row.crs or stated.crs
    if code is None:
        raise InputError(f'{row.where}: x and y need their CRS: write crs = "EPSG:CODE" in [control]')
    crs = CRS.from_user_input(code)
    try:
        transformer = Transformer.from_crs(horizontal_part(crs), LONLAT, always_xy=True, allow_ballpark=False)
        lon, lat = (float(value) for value in transformer.transform(row.x, row.y))
    except (ProjError, CRSError) as error:
        raise InputError(f"{row.where}: {code} cannot be brought to WGS 84: {error}") from error
    if not (isfinite(lon) and abs(lat) <= 90 and abs(lon) <= 360):
        raise InputError(
            f"{row.where}: {row.x:g} {row.y:g} is not on Earth in {code}; are longitude and latitude, or east and "
            "north, exchanged?"
        )
    accuracy, default = row.accuracy, stated.accuracy
    sigma_h = default.sigma_h if accuracy.sigma_h is None else accuracy.sigma_h
    sigma_v = default.sigma_v if accuracy.sigma_v is None else accuracy.sigma_v
    in_plan = isnan(row.z)
    missing = [name for name, value in (("ce90", sigma_h), ("le90", 0 if in_plan else sigma_v)) if value is None]
    if missing:
        flags = " ".join(f"--control-{name} M" for name in missing)
        keys = " and ".join(f"{name} = M" for name in missing)
        raise InputError(
            f"{row.where}: the accuracy of the control is not stated: write {keys} in [control], or give {flags}, or "
            "columns sigma_h and sigma_v"
        )
    height = nan if in_plan else _height(row, crs, stated, lat, lon)
    return Place(lat, lon, height, sigma_h or 0.0, nan if in_plan else sigma_v or 0.0, row.where)


def _height(row: Row, crs: CRS, stated: Stated, lat: float, lon: float) -> float:
    """Metres above the ellipsoid, by the datum that the CRS carries, else by the one that is stated."""
    datum = vertical_datum_of(crs) or stated.vertical_datum
    if datum is None:
        raise InputError(
            f'{row.where}: the vertical datum of the control is not stated: write vertical_datum = "ellipsoid" or '
            '"EPSG:CODE" in [control], or give --control-datum'
        )
    try:
        return float(ellipsoidal_heights(np.array([lat]), np.array([lon]), np.array([row.z]), datum)[0])
    except InputError as error:
        raise InputError(f"{row.where}: {error}") from error
