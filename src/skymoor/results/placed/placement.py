# SPDX-License-Identifier: Apache-2.0
"""Where a model belongs: from its own coordinates to those of the site and of the map."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS

from skymoor.geo import EnuFrame
from skymoor.geometry import Similarity
from skymoor.results.formats._crs import MapFrame
from skymoor.results.formats.cameras import georeference
from skymoor.types import Array, HeightStatus


@dataclass(frozen=True, eq=False)
class Placement:
    """ENU metres from the model's coordinates, and the frame on Earth.

    `crs` is a map projection: the reference's, or where that has degrees the UTM zone. `ground` is the coordinate along
    the model's z at which an orthophoto without heights lies.
    """

    enu_from_model: Similarity
    frame: EnuFrame
    crs: str
    heights: HeightStatus | None
    ground: float = 0.0

    @classmethod
    def on(
        cls, enu_from_model: Similarity, frame: EnuFrame, crs: str, heights: HeightStatus | None, ground: float
    ) -> Placement:
        """With a map projection in metres for the reference's `crs`."""
        projected = CRS.from_user_input(crs).is_projected
        return cls(enu_from_model, frame, crs if projected else frame.utm_zone, heights, ground)

    def offset_by(self, offset: tuple[float, float, float]) -> Placement:
        """For a file to whose coordinates that is added."""
        if not any(offset):
            return self
        return replace(self, enu_from_model=self.enu_from_model @ Similarity(1.0, np.eye(3), np.array(offset)))

    @property
    def chart(self) -> MapFrame:
        """The map projection."""
        return MapFrame(self.frame, self.crs)

    def enu(self, xyz: ArrayLike) -> Array:
        """ENU metres (n, 3) of the model's coordinates (n, 3)."""
        return self.enu_from_model.apply(np.asarray(xyz, np.float64).reshape(-1, 3))

    def map(self, xyz: ArrayLike) -> Array:
        """Map x, y and ellipsoidal height (n, 3) of the model's coordinates (n, 3)."""
        return self.chart.map_from_enu(self.enu(xyz))

    def directions(self, vectors: ArrayLike) -> Array:
        """Directions (n, 3) of the model in ENU."""
        return np.asarray(vectors, np.float64) @ self.enu_from_model.rotation.T

    def described(self) -> dict[str, object]:
        """What goes beside files in ENU metres."""
        return georeference(self.frame, self.enu_from_model, self.heights)

    def comments(self) -> list[str]:
        """The origin, for formats that hold text."""
        return [
            "x east, y north, z up: metres from a local origin, not map coordinates",
            f"origin WGS 84 latitude {self.frame.lat_deg!r} longitude {self.frame.lon_deg!r}",
            f"origin height {self.frame.height_m!r} m above the WGS 84 ellipsoid",
        ]


def local_projection(frame: EnuFrame) -> str:
    """A transverse Mercator projection around a place, which within kilometres is its plan."""
    return (
        f"+proj=tmerc +lat_0={frame.lat_deg!r} +lon_0={frame.lon_deg!r} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m "
        "+no_defs +type=crs"
    )
