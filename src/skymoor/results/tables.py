# SPDX-License-Identifier: Apache-2.0
"""Tables: truth.csv of a user, cameras.csv of a run."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from skymoor.engines.regular import regular
from skymoor.errors import InputError
from skymoor.evaluate import Estimate, Truth

TRUTH_COLUMNS = ("image", "lat", "lon", "height")
ACCURACY = ("ce90", "le90")
RELATIVE = ("relative_ce90", "relative_le90")  # runs of former versions have none
ESTIMATED = ("lat", "lon", "height", *ACCURACY, *RELATIVE)
TEXTS = ("image", "set", "component", "status", "heights")
REQUIRED_COLUMNS = ("image", "set", "component", "status", "lat", "lon", "height", *ACCURACY)


@dataclass(frozen=True)
class CameraRow:
    """One line of cameras.csv, columns in this order; everything from `lat` on is None where it is not registered.

    Latitude and longitude in WGS 84 degrees, height above its ellipsoid, and east, north, up of the site in metres;
    `heights` is the verdict on them: where it is NOT_CONFIRMED, height and LE90 are None, and `up` is relative;
    the quaternion is camera-from-ENU; `ce90` and `le90` are predicted metres, and `relative_ce90` and `relative_le90`
    the same without the error of the reference, which all cameras share.
    """

    image: str
    set: str
    component: int | None
    status: str
    lat: float | None = None
    lon: float | None = None
    height: float | None = None
    east: float | None = None
    north: float | None = None
    up: float | None = None
    qw: float | None = None
    qx: float | None = None
    qy: float | None = None
    qz: float | None = None
    ce90: float | None = None
    le90: float | None = None
    relative_ce90: float | None = None
    relative_le90: float | None = None
    heights: str | None = None


CAMERA_COLUMNS = tuple(item.name for item in fields(CameraRow))


def read_truth_csv(path: Path) -> list[Truth]:
    """Read `image,lat,lon,height` (WGS 84 degrees, ellipsoidal metres); more columns are allowed.

    Raises `InputError`, naming file and line, for a missing column, a number that is none or out of range, and an
    image that is listed twice.
    """
    truths: dict[str, Truth] = {}
    for line, row in _rows(path, TRUTH_COLUMNS):
        where = f"{path}, line {line}"
        image = row["image"].strip().replace("\\", "/")
        if not image:
            raise InputError(f"{where}: the image has no name")
        if image in truths:
            raise InputError(f"{where}: the image {image} was listed before; keep one line")
        numbers = [_number(row[column], column, where) for column in TRUTH_COLUMNS[1:]]
        truths[image] = Truth(image, *numbers)
    if not truths:
        raise InputError(f"{path}: lists no images")
    return list(truths.values())


def read_cameras_csv(path: Path) -> list[Estimate]:
    """Read the cameras.csv of a run. Raises `InputError`, naming file and line, for whatever does not fit."""
    return [
        Estimate(
            row["image"],
            row["set"],
            row["component"],
            row["status"] == "REGISTERED",
            **numbers,
            heights=row["heights"],
        )
        for row, numbers in _cameras(path, ESTIMATED)
    ]


def read_camera_rows(path: Path) -> list[CameraRow]:
    """The same with all columns of cameras.csv."""
    columns = [item.name for item in fields(CameraRow) if item.name not in TEXTS]
    return [CameraRow(**row, **numbers) for row, numbers in _cameras(path, columns)]


def _cameras(path: Path, columns: Sequence[str]) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Image, set, component and status of each line, and the numbers in these columns, None where there is none."""
    for line, row in _rows(path, REQUIRED_COLUMNS):
        where = f"{path}, line {line}"
        if row["status"] not in ("REGISTERED", "NOT_REGISTERED"):
            raise InputError(f"{where}: status {row['status']!r} is neither REGISTERED nor NOT_REGISTERED")
        component = row["component"].strip()
        if component and not re.fullmatch("[0-9]{1,9}", component):
            raise InputError(f"{where}: component {component!r} is not a number")
        numbers = {
            column: _number(row[column], column, where) if row.get(column, "").strip() else None for column in columns
        }
        texts = {"image": row["image"], "set": row["set"], "status": row["status"]}
        heights = row.get("heights", "").strip() or None  # runs of former versions have no such column
        yield {**texts, "component": int(component) if component else None, "heights": heights}, numbers


def _rows(path: Path, columns: Sequence[str]) -> list[tuple[int, Mapping[str, str]]]:
    """Lines with their numbers, every cell text. Raises `InputError`, naming file and line, for what is no table."""
    try:
        # utf-8-sig: spreadsheets put a byte order mark in front of the first column's name.
        with regular(path).open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, strict=True)
            header = [name.strip() for name in reader.fieldnames or ()]
            missing = [column for column in columns if column not in header]
            if missing:
                raise InputError(
                    f"{path}: the column {missing[0]} is missing; the first line must have {','.join(columns)}"
                )
            reader.fieldnames = header
            rows: list[tuple[int, Mapping[str, str]]] = [(reader.line_num, row) for row in reader]
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as a table: {error}") from error
    for line, row in rows:
        if None in row or None in row.values():
            raise InputError(f"{path}, line {line}: has {'more' if None in row else 'fewer'} cells than the first line")
    return rows


def _number(text: str, column: str, where: str) -> float:
    try:
        number = float(text)
    except ValueError:
        raise InputError(f"{where}: {column} = {text!r} is not a number") from None
    limit = {"lat": 90.0, "lon": 360.0}.get(column, 1e6)
    if not math.isfinite(number) or abs(number) > limit:
        raise InputError(f"{where}: {column} = {text} is out of range")
    return number
