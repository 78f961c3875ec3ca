# SPDX-License-Identifier: Apache-2.0
"""What a surveyor gives: points with their pixels, known camera positions, and scale bars."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

from skymoor.errors import InputError

Size = tuple[int, int]


@dataclass(frozen=True)
class Mark:
    """A point in a photo: pixel (u, v), the centre of the first one is (0.5, 0.5); `where` is file and line."""

    image: str
    u: float
    v: float
    where: str


@dataclass(frozen=True)
class Place:
    """A surveyed position: WGS 84 degrees and metres above the ellipsoid, NaN where only the plan is known.

    `sigma_h` is the standard deviation of each horizontal axis and `sigma_v` that of the height, metres; `where` is
    file and line.
    """

    lat: float
    lon: float
    height: float
    sigma_h: float
    sigma_v: float
    where: str


@dataclass(frozen=True)
class ControlPoint:
    """A point that photos show; `place` is None for one that only scale bars use."""

    name: str
    marks: tuple[Mark, ...]
    place: Place | None


@dataclass(frozen=True)
class KnownPosition:
    """The known position of a photo's projection centre."""

    image: str
    place: Place


@dataclass(frozen=True)
class ScaleBar:
    """The known distance of two points by their names, and its standard deviation, metres."""

    a: str
    b: str
    length_m: float
    sigma_m: float
    where: str

    @property
    def name(self) -> str:
        """Both ends."""
        return f"{self.a} to {self.b}"


@dataclass(frozen=True)
class Control:
    """All that is given of a site; `use` says that models are moved onto it, else they are compared with it only."""

    points: tuple[ControlPoint, ...] = ()
    positions: tuple[KnownPosition, ...] = ()
    bars: tuple[ScaleBar, ...] = ()
    use: bool = False

    @property
    def places(self) -> list[tuple[str, Place]]:
        """Every surveyed position with its name."""
        points = [(one.name, one.place) for one in self.points if one.place is not None]
        return [*points, *((one.image, one.place) for one in self.positions)]


def resolved(control: Control, photos: Mapping[str, Size | None]) -> tuple[Control, list[str]]:
    """The same with the names of the run's photos, and a line about those that it does not have.

    Args:
        control: photos are named as in the results, relative to the site, or by the bare name of the file.
        photos: sizes (width, height) by name; None where a size is not known.

    Raises `InputError`, naming file and line, for a bare name that several photos have, for a pixel outside its photo,
    and where none of the photos that are named is here.
    """
    bare: dict[str, list[str]] = {}
    for name in photos:
        bare.setdefault(PurePosixPath(name).name, []).append(name)
    absent: Counter[str] = Counter()

    def full(image: str, where: str) -> str | None:
        if image in photos:
            return image
        found = bare.get(image, [])
        if len(found) > 1:
            raise InputError(f"{where}: {image} may be {found[0]} or {found[1]}; write the one that is meant")
        absent.update([] if found else [image])
        return found[0] if found else None

    points = []
    for point in control.points:
        named = [(mark, full(mark.image, mark.where)) for mark in point.marks]
        marks = [replace(mark, image=image) for mark, image in named if image is not None]
        _require_inside(marks, photos)
        points.append(replace(point, marks=tuple(marks)))
    known = [(one, full(one.image, one.place.where)) for one in control.positions]
    positions = [replace(one, image=image) for one, image in known if image is not None]
    if absent and not positions and not any(point.marks for point in points):
        first = next(iter(_places_of(control)))
        raise InputError(f"{first}: none of the photos named there is in the site, such as {next(iter(absent))}")
    found = replace(control, points=tuple(points), positions=tuple(positions))
    return found, _notes(absent)


def _places_of(control: Control) -> Iterable[str]:
    for point in control.points:
        yield from (mark.where for mark in point.marks)
    yield from (one.place.where for one in control.positions)


def _require_inside(marks: Sequence[Mark], photos: Mapping[str, Size | None]) -> None:
    for mark in marks:
        size = photos[mark.image]
        if size is not None and not (0 <= mark.u <= size[0] and 0 <= mark.v <= size[1]):
            raise InputError(
                f"{mark.where}: pixel {mark.u:g} {mark.v:g} lies outside of {mark.image}, which has {size[0]} by "
                f"{size[1]} pixels; was it measured in a photo of another size?"
            )


def _notes(absent: Counter[str]) -> list[str]:
    if not absent:
        return []
    names = sorted(absent)
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return [f"control: {', '.join(names[:3])}{more}: not among the photos of the site; left out"]
