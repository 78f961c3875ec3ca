# SPDX-License-Identifier: Apache-2.0
"""Files of control: gcp_list.txt and geo.txt of OpenDroneMap, and tables of points, positions and scale bars."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from skymoor.control import Control, ControlPoint, KnownPosition, Mark, ScaleBar
from skymoor.engines.regular import regular
from skymoor.errors import InputError
from skymoor.pipeline.control_places import NO_PLACE, Accuracy, Coordinates, Row, Stated, crs_of, number_of, places_of

POINT_COLUMNS = ("point", "image", "px", "py")
BAR_COLUMNS = ("point_a", "point_b", "length_m", "sigma_m")
KINDS = (
    "an ODM list begins with its CRS, such as EPSG:32632; a table with a line of its columns: point,image,px,py and "
    "lat,lon,height, or image,lat,lon,height, or point_a,point_b,length_m,sigma_m"
)
ODM_HALF_PX = 0.5  # ODM's first pixel has its centre at (0, 0), ours at (0.5, 0.5)


@dataclass(frozen=True)
class _Sighting:
    """One line about a point: its name, its pixel, and its coordinates where the line has some."""

    point: str
    mark: Mark
    row: Row | None


def read_control(files: Sequence[Path], stated: Stated, *, use: bool = False) -> Control:
    """What all files give, of whatever kind each of them is.

    Raises `InputError`, naming file and line, for what is missing, no number, contradictory or of an unknown kind.
    """
    sightings: list[_Sighting] = []
    rows: list[tuple[str, Row]] = []
    bars: list[ScaleBar] = []
    for path in files:
        lines = _lines(path)
        table = _table(path, lines)
        if table is None:
            in_list = _odm_list(path, lines)
            sightings += [one for one in in_list if isinstance(one, _Sighting)]
            rows += [one for one in in_list if not isinstance(one, _Sighting)]
        elif "point_a" in table[0]:
            bars += list(_bars(path, table))
        elif "point" in table[0]:
            sightings += _points(path, table)
        else:
            rows += _positions(path, table)
    points = _joined(sightings, stated)
    positions = tuple(
        KnownPosition(image, place)
        for (image, _), place in zip(rows, places_of([row for _, row in rows], stated), strict=True)
    )
    _require_once([(one.image, one.place.where) for one in positions])
    names = {point.name for point in points}
    for bar in bars:
        missing = [name for name in (bar.a, bar.b) if name not in names]
        if missing:
            raise InputError(f"{bar.where}: there is no point {missing[0]}; give its pixels in a table of points")
    return Control(points, positions, tuple(bars), use)


def _lines(path: Path) -> list[tuple[int, str]]:
    """Lines with their numbers, without blank ones and comments."""
    try:
        text = regular(path).read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from error
    lines = [(k, line.strip()) for k, line in enumerate(text.splitlines(), 1)]
    lines = [(k, line) for k, line in lines if line and not line.startswith("#")]
    if len(lines) < 2:
        raise InputError(f"{path}: is empty; {KINDS}")
    return lines


Table = tuple[tuple[str, ...], list[tuple[str, Mapping[str, str]]]]


def _table(path: Path, lines: Sequence[tuple[int, str]]) -> Table | None:
    """Columns and rows of a table of comma-separated values, each with file and line; None for what is none."""
    header = tuple(cell.strip().lower() for cell in lines[0][1].split(","))
    if not {"image", "point_a"} & set(header):
        return None
    wanted = BAR_COLUMNS if "point_a" in header else POINT_COLUMNS if "point" in header else ("image",)
    missing = [name for name in wanted if name not in header]
    if missing:
        raise InputError(f"{path}: the column {missing[0]} is missing; a table of this kind has {','.join(wanted)}")
    rows: list[tuple[str, Mapping[str, str]]] = []
    for k, line in lines[1:]:
        where = f"{path}, line {k}"
        try:
            cells = [cell.strip() for cell in next(csv.reader([line]))]
        except csv.Error as error:
            raise InputError(f"{where}: is no line of a table: {error}") from error
        if len(cells) != len(header):
            raise InputError(f"{where}: has {len(cells)} cells, the first line {len(header)}")
        rows.append((where, dict(zip(header, cells, strict=True))))
    return header, rows


def _points(path: Path, table: Table) -> Iterator[_Sighting]:
    coordinates = Coordinates.of_table(path, table[0], required=False)
    for where, cells in table[1]:
        u, v = (number_of(cells[name], name, where) for name in ("px", "py"))
        name, image = (_text(cells[key], key, where) for key in ("point", "image"))
        row = None if coordinates is None else coordinates.row(cells, where)
        yield _Sighting(name, Mark(image, u, v, where), row)


def _positions(path: Path, table: Table) -> Iterator[tuple[str, Row]]:
    coordinates = Coordinates.of_table(path, table[0], required=True)
    assert coordinates is not None
    for where, cells in table[1]:
        row = coordinates.row(cells, where)
        if row is None:
            raise InputError(f"{where}: {NO_PLACE}")
        yield _text(cells["image"], "image", where), row


def _bars(path: Path, table: Table) -> Iterator[ScaleBar]:
    for where, cells in table[1]:
        a, b = (_text(cells[key], key, where) for key in ("point_a", "point_b"))
        length, sigma = (number_of(cells[key], key, where) for key in ("length_m", "sigma_m"))
        if a == b or length <= 0 or sigma <= 0:
            raise InputError(f"{where}: a scale bar needs two points, and length_m and sigma_m above zero")
        yield ScaleBar(a, b, length, sigma, where)


def _odm_list(path: Path, lines: Sequence[tuple[int, str]]) -> list[_Sighting | tuple[str, Row]]:
    """gcp_list.txt: x y z px py image [name]; or geo.txt: image x y [z yaw pitch roll [sigma_h sigma_v]]."""
    first, header = lines[0]
    crs = crs_of(header, f"{path}, line {first}", KINDS)
    found: list[_Sighting | tuple[str, Row]] = []
    for k, line in lines[1:]:
        words, where = line.split(), f"{path}, line {k}"
        try:
            float(words[0])
        except ValueError:
            found.append(_geo_line(words, crs, where))
            continue
        if len(words) < 6:
            raise InputError(f"{where}: has {len(words)} words; a control point has x y z px py image")
        x, y, u, v = (number_of(words[j], name, where) for j, name in ((0, "x"), (1, "y"), (3, "px"), (4, "py")))
        z = number_of(words[2], "z", where, may_be_nan=True)
        mark = Mark(words[5], u + ODM_HALF_PX, v + ODM_HALF_PX, where)
        name = words[6] if len(words) > 6 else f"{words[0]} {words[1]}"
        found.append(_Sighting(name, mark, Row(x, y, z, crs, Accuracy(), where)))
    return found


def _geo_line(words: Sequence[str], crs: str, where: str) -> tuple[str, Row]:
    if len(words) < 3:
        raise InputError(
            f"{where}: has {len(words)} words; a position has image x y, a control point x y z px py image"
        )
    x, y = (number_of(words[j], name, where) for j, name in ((1, "x"), (2, "y")))
    z = number_of(words[3], "z", where, may_be_nan=True) if len(words) > 3 else float("nan")
    sigmas = [number_of(words[j], "accuracy", where) if len(words) > j else 0.0 for j in (7, 8)]
    accuracy = Accuracy(*(value if value > 0 else None for value in sigmas))
    return words[0], Row(x, y, z, crs, accuracy, where)


def _joined(sightings: Sequence[_Sighting], stated: Stated) -> tuple[ControlPoint, ...]:
    """All lines about one point together; one of them must have its coordinates, unless only scale bars use it."""
    by_name: dict[str, list[_Sighting]] = {}
    for one in sightings:
        by_name.setdefault(one.point, []).append(one)
    rows: dict[str, Row] = {}
    for name, group in by_name.items():
        _require_once([(one.mark.image, one.mark.where) for one in group], name)
        with_rows = [one.row for one in group if one.row is not None]
        for row in with_rows[1:]:
            if not row.same_place(with_rows[0]):
                raise InputError(f"{row.where}: {name} has other coordinates than in {with_rows[0].where}")
        if with_rows:
            rows[name] = with_rows[0]
    places = dict(zip(rows, places_of(list(rows.values()), stated), strict=True))
    return tuple(
        ControlPoint(name, tuple(one.mark for one in group), places.get(name)) for name, group in by_name.items()
    )


def _require_once(named: Sequence[tuple[str, str]], point: str = "") -> None:
    seen: dict[str, str] = {}
    for image, where in named:
        if image in seen:
            of = f" for {point}" if point else ""
            raise InputError(f"{where}: {image} is listed{of} before, in {seen[image]}; keep one line")
        seen[image] = where


def _text(cell: str, name: str, where: str) -> str:
    if not cell:
        raise InputError(f"{where}: {name} is empty")
    return cell.replace("\\", "/")
