# SPDX-License-Identifier: Apache-2.0
"""Vertical datums: heights above the WGS 84 ellipsoid from the heights of a DSM. No datum is assumed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError, ProjError
from pyproj.transformer import TransformerGroup

from skymoor.errors import InputError
from skymoor.geo.operations import EXACT, Operation, needed_grid, operation_of, operations_between

Array = NDArray[np.float64]

ELLIPSOID = "ellipsoid"
_HOW_TO_STATE = (
    'give reference.vertical_datum as "ellipsoid" or as the EPSG code of a vertical CRS, such as "EPSG:3855"'
)


Heights = Callable[[ArrayLike, ArrayLike, ArrayLike], Array]
"""Ellipsoidal heights (n,) in metres at latitudes, longitudes (degrees) and heights of some datum, each (n,)."""


@dataclass(frozen=True)
class ToEllipsoid:
    """The conversion of one datum's heights at one site, and how accurate it is."""

    heights: Heights
    operation: Operation = EXACT


def ellipsoidal_heights(lat: ArrayLike, lon: ArrayLike, height: ArrayLike, vertical_datum: str) -> Array:
    """Heights (n,) in metres above the WGS 84 ellipsoid of heights (n,) in a vertical datum, at WGS 84 degrees (n,).

    `vertical_datum` is "ellipsoid" or a vertical CRS such as "EPSG:3855"; `height` is in the unit of that CRS.
    NaN heights stay NaN. Raises `InputError` when the datum is unknown, when every transformation of PROJ needs a geoid
    grid that is not installed (the message names the file), or when the grid does not cover a position.
    """
    return ellipsoid_from_datum(vertical_datum, lat, lon).heights(lat, lon, height)


def ellipsoid_from_datum(vertical_datum: str, lat: ArrayLike, lon: ArrayLike) -> ToEllipsoid:
    """`ellipsoidal_heights` for a site: one transformation of PROJ for the area of the positions (n,) in degrees."""
    crs = _vertical_crs(vertical_datum)
    if crs is None:
        return ToEllipsoid(lambda lat, lon, height: np.array(_broadcast(lat, lon, height)[2]))
    group = _operations(crs, vertical_datum, np.asarray(lat, np.float64), np.asarray(lon, np.float64))
    transformer = group.transformers[0]

    def heights(lat: ArrayLike, lon: ArrayLike, height: ArrayLike) -> Array:
        lats, lons, own = _broadcast(lat, lon, height)
        known = np.isfinite(own)
        converted = np.asarray(transformer.transform(lons, lats, np.where(known, own, 0.0))[2], dtype=np.float64)
        if not np.isfinite(converted).all():
            raise InputError(
                f"vertical datum {vertical_datum} ({crs.name}): its geoid grid does not cover latitude "
                f"{lats.ravel()[0]:.4f}, longitude {lons.ravel()[0]:.4f}; convert the DSM to ellipsoidal heights"
            )
        return np.where(known, converted, np.nan)

    return ToEllipsoid(heights, operation_of(transformer, group.unavailable_operations, "vertical"))


def datum_from_ellipsoid(lat: ArrayLike, lon: ArrayLike, height: ArrayLike, vertical_datum: str) -> Array:
    """The inverse of `ellipsoidal_heights`: heights (n,) in the datum of ellipsoidal heights (n,); raises the same."""
    crs = _vertical_crs(vertical_datum)
    lats, lons, own = _broadcast(lat, lon, height)
    if crs is None:
        return np.array(own)
    transformer: Transformer = _operations(crs, vertical_datum, lats, lons).transformers[0]
    converted = transformer.transform(lons, lats, own, direction="INVERSE")[2]
    if not np.isfinite(converted).all():
        raise InputError(
            f"vertical datum {vertical_datum} ({crs.name}): its geoid grid does not cover the site; "
            "choose another vertical datum"
        )
    return np.asarray(converted, dtype=np.float64)


def vertical_datum_of(crs: Any) -> str | None:
    """The vertical datum that the CRS of a DSM carries: "ellipsoid", an EPSG code, WKT without one, or None.

    `crs` is anything that pyproj accepts, or a CRS with `to_wkt`.
    """
    crs = CRS.from_user_input(crs)
    if crs.is_compound:
        vertical = next((part for part in crs.sub_crs_list if part.is_vertical), None)
        return None if vertical is None else _name(vertical)
    return ELLIPSOID if len(crs.axis_info) == 3 and not crs.is_geocentric else None


def same_vertical_datum(a: str, b: str) -> bool:
    """Whether two vertical datums, as accepted by `ellipsoidal_heights`, are the same."""
    return _vertical_crs(a) == _vertical_crs(b)


def unit_of_datum(vertical_datum: str) -> float:
    """Metres in the unit of a vertical datum, as accepted by `ellipsoidal_heights`; 1 for the ellipsoid."""
    crs = _vertical_crs(vertical_datum)
    return 1.0 if crs is None else float(crs.axis_info[0].unit_conversion_factor)


def vertical_unit_of(crs: Any) -> float | None:
    """Metres in the unit of the heights that a compound or 3D CRS states; None for a two-dimensional one."""
    whole = CRS.from_user_input(crs)
    if vertical_datum_of(whole) is None:
        return None
    return float(whole.axis_info[-1].unit_conversion_factor)


def horizontal_part(crs: Any) -> CRS:
    """The two-dimensional CRS (pyproj) within a compound or 3D one."""
    whole = CRS.from_user_input(crs)
    part: CRS = whole.sub_crs_list[0] if whole.is_compound else whole
    return part.to_2d() if len(part.axis_info) == 3 and not part.is_geocentric else part


def _broadcast(*values: ArrayLike) -> tuple[Array, ...]:
    return np.broadcast_arrays(*(np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in values))


def _name(vertical: CRS) -> str:
    code = vertical.to_epsg()
    return vertical.to_wkt() if code is None else f"EPSG:{code}"


def _vertical_crs(vertical_datum: str) -> CRS | None:
    """The vertical CRS, or None for heights above the ellipsoid."""
    text = str(vertical_datum).strip()
    if text.lower() == ELLIPSOID:
        return None
    try:
        crs = CRS.from_user_input(text)
    except CRSError:
        raise InputError(f"vertical datum {text!r} is not known; {_HOW_TO_STATE}") from None
    if crs.is_vertical and not crs.is_compound:
        return crs
    inner = vertical_datum_of(crs)
    if inner is None:
        raise InputError(f"{text!r} ({crs.name}) has no vertical datum; {_HOW_TO_STATE}")
    return None if inner == ELLIPSOID else CRS.from_user_input(inner)


def _operations(vertical: CRS, vertical_datum: str, lat: Array, lon: Array) -> TransformerGroup:
    """PROJ's transformations from the datum to the ellipsoid, the best installed one first; at least one.

    Raises `InputError`, with the grid that is missing, where none is installed.
    """
    area = AreaOfInterest(float(lon.min()), float(lat.min()), float(lon.max()), float(lat.max()))
    try:
        group = operations_between(CompoundCRS("site", [CRS("EPSG:4326"), vertical]), CRS("EPSG:4979"), area)
    except ProjError as error:
        raise InputError(f"vertical datum {vertical_datum} ({vertical.name}) cannot be used: {error}") from None
    if group.transformers:
        return group
    grid = needed_grid(group)
    if not grid:
        raise InputError(
            f"vertical datum {vertical_datum} ({vertical.name}): PROJ has no transformation from it to "
            "ellipsoidal heights at the site; convert the DSM to ellipsoidal heights, or check the code"
        )
    raise InputError(f"vertical datum {vertical_datum} ({vertical.name}) needs the geoid grid {grid}")
