# SPDX-License-Identifier: Apache-2.0
"""From the site's frame to the reference's map projection."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.geo.datum import horizontal_part

Array = NDArray[np.float64]

# WGS 84 and GRS 80 have this equatorial radius, and their heights agree to a millimetre.
WGS84_RADIUS_M = 6378137.0


@dataclass(frozen=True)
class MapFrame:
    """The map projection `crs` (text that PROJ knows) over a site, with heights above the WGS 84 ellipsoid.

    The reference is read with the same convention. A vertical part of the CRS is dropped.
    """

    frame: EnuFrame
    crs: str

    @cached_property
    def horizontal(self) -> CRS:
        """The two-dimensional CRS. Raises `InputError` when the text is no CRS of the Earth's surface."""
        try:
            crs = horizontal_part(self.crs)
        except CRSError as error:
            raise InputError(f"coordinate reference system {self.crs!r} is not known: {error}") from error
        if not (crs.is_projected or (crs.is_geographic and not crs.is_geocentric)):
            raise InputError(f"coordinate reference system {crs.name!r} is neither projected nor geographic")
        return crs

    @property
    def with_heights(self) -> CRS:
        """A CRS whose third axis is our heights; the two-dimensional one where heights above its ellipsoid differ."""
        ellipsoid = self.horizontal.ellipsoid
        same = ellipsoid is not None and ellipsoid.semi_major_metre == WGS84_RADIUS_M
        return self.horizontal.to_3d() if same else self.horizontal

    @property
    def is_degrees(self) -> bool:
        """Whether map coordinates are angles."""
        return bool(self.horizontal.is_geographic)

    def map_from_enu(self, xyz_enu: ArrayLike) -> Array:
        """Map x (east or longitude), y and ellipsoidal height (n, 3) of positions (n, 3) in metres."""
        lat, lon, height = self.frame.lla_from_enu(xyz_enu).T
        x, y = self._map_from_lon_lat.transform(lon, lat)
        return np.column_stack([x, y, height])

    def enu_from_map(self, xyz_map: ArrayLike) -> Array:
        """The inverse of `map_from_enu`."""
        x, y, height = np.asarray(xyz_map, dtype=np.float64).reshape(-1, 3).T
        lon, lat = self._map_from_lon_lat.transform(x, y, direction="INVERSE")
        return self.frame.enu_from_lla(lat, lon, height)

    @cached_property
    def _map_from_lon_lat(self) -> Transformer:
        return Transformer.from_crs("EPSG:4326", self.horizontal, always_xy=True)


def enu_from_map(xyz_map: ArrayLike, frame: EnuFrame, crs: str) -> Array:
    """ENU metres (n, 3) of map x, y and ellipsoidal height (n, 3) in a CRS. Raises `InputError` for an unknown CRS."""
    return MapFrame(frame, crs).enu_from_map(xyz_map)
