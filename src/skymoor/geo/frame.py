# SPDX-License-Identifier: Apache-2.0
"""The local frame of a site: metres east, north and up of an origin on the WGS 84 ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import Transformer

from skymoor.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EnuFrame:
    """East-north-up axes at an origin given in WGS 84 degrees and ellipsoidal metres.

    The axes are straight: 1 km away from the origin the ellipsoid is 8 cm below the plane up = 0.
    Raises `InputError` when the origin is not on Earth.
    """

    lat_deg: float
    lon_deg: float
    height_m: float

    def __post_init__(self) -> None:
        if not (abs(self.lat_deg) <= 90 and abs(self.lon_deg) <= 360 and abs(self.height_m) < 1e6):
            raise InputError(
                f"origin latitude {self.lat_deg}, longitude {self.lon_deg}, height {self.height_m} is not on Earth; "
                "give WGS 84 degrees and metres"
            )

    def enu_from_lla(self, lat: ArrayLike, lon: ArrayLike, height: ArrayLike) -> Array:
        """Positions (n, 3) in metres from WGS 84 degrees and ellipsoidal metres, each (n,) or one number."""
        lat, lon, height = np.broadcast_arrays(
            *(np.atleast_1d(np.asarray(values, dtype=np.float64)) for values in (lat, lon, height))
        )
        east, north, up = self._enu_from_lon_lat().transform(lon.ravel(), lat.ravel(), height.ravel())
        return np.column_stack([east, north, up])

    def lla_from_enu(self, xyz: ArrayLike) -> Array:
        """Latitude, longitude (degrees) and ellipsoidal height (m) as (n, 3) of positions (n, 3) in metres."""
        enu = np.asarray(xyz, dtype=np.float64).reshape(-1, 3)
        lon, lat, height = self._enu_from_lon_lat().transform(enu[:, 0], enu[:, 1], enu[:, 2], direction="INVERSE")
        return np.column_stack([lat, lon, height])

    @property
    def utm_zone(self) -> str:
        """EPSG code of the UTM zone of the origin on WGS 84."""
        zone = int((self.lon_deg + 180) % 360 // 6) + 1
        return f"EPSG:{(32600 if self.lat_deg >= 0 else 32700) + zone}"

    def _enu_from_lon_lat(self) -> Transformer:
        return _topocentric(float(self.lat_deg), float(self.lon_deg), float(self.height_m))


@lru_cache(maxsize=64)
def _topocentric(lat_deg: float, lon_deg: float, height_m: float) -> Transformer:
    return Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        "+step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={lat_deg!r} +lon_0={lon_deg!r} +h_0={height_m!r}"
    )
