# SPDX-License-Identifier: Apache-2.0
"""Positions in another coordinate reference system, with its vertical datum where it has one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS
from pyproj.aoi import AreaOfInterest
from pyproj.exceptions import CRSError, ProjError

from skymoor.errors import InputError
from skymoor.geo.operations import needed_grid, operations_between

Array = NDArray[np.float64]

_EXAMPLES = 'give an EPSG code such as "EPSG:32632", or with a vertical datum "EPSG:32632+3855"'


def map_crs(crs: Any) -> CRS:
    """The CRS (pyproj) that a text, a code or another library's CRS means.

    Raises `InputError` where it is not known, or has no position in plan, as a vertical one.
    """
    try:
        found = CRS.from_user_input(crs)
    except CRSError:
        raise InputError(f"CRS {crs!r} is not known to PROJ; {_EXAMPLES}") from None
    if len(found.axis_info) < 2 or not (found.is_projected or found.is_geographic or found.is_geocentric):
        raise InputError(f"CRS {crs!r} ({found.name}) does not state a position on Earth; {_EXAMPLES}")
    return found


def positions_in(crs: CRS, lat: ArrayLike, lon: ArrayLike, height: ArrayLike) -> Array:
    """Positions (n, 3) in a CRS of WGS 84 degrees and metres above its ellipsoid, each (n,), or (n, 2) in a 2D CRS.

    x is east or longitude, whatever order of axes the CRS has, as in the files of GIS; z is the height in the datum and
    the unit of the CRS, and NaN where the height is NaN. PROJ's best operation that is installed is used, and never one
    that leaves out a shift of the datum. Raises `InputError` where there is none, with the grid that is missing, or
    where its grid does not cover a position.
    """
    lats, lons, own = (np.atleast_1d(np.asarray(values, np.float64)) for values in (lat, lon, height))
    solid = len(crs.axis_info) == 3
    if not len(lats):
        return np.zeros((0, 3 if solid else 2))
    known = np.isfinite(own)
    if crs.is_geocentric and not known.all():
        raise InputError(f"CRS {crs.name} is geocentric, and a height is not confirmed: choose a projected CRS")
    area = AreaOfInterest(float(lons.min()), float(lats.min()), float(lons.max()), float(lats.max()))
    source = CRS("EPSG:4979" if solid else "EPSG:4326")
    try:
        group = operations_between(source, crs, area)
    except ProjError as error:
        raise InputError(f"CRS {crs.name} cannot be used: {error}") from None
    if not group.transformers:
        grid = needed_grid(group)
        lacks = "PROJ has no transformation to it from WGS 84 at the site; choose a CRS of that region"
        raise InputError(f"CRS {crs.name} needs the grid {grid}" if grid else f"CRS {crs.name}: {lacks}")
    given = (lons, lats, np.where(known, own, 0.0)) if solid else (lons, lats)
    found: Array = np.column_stack(group.transformers[0].transform(*given))
    if not np.isfinite(found).all():
        raise InputError(
            f"CRS {crs.name} is not defined, or its grid has no values, at latitude {lats[0]:.4f}, longitude "
            f"{lons[0]:.4f}; choose a CRS of that region"
        )
    if solid and not crs.is_geocentric:
        found[~known, 2] = np.nan
    return found
