# SPDX-License-Identifier: Apache-2.0
"""Point clouds as PLY, in metres of the site."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skymoor.geo import EnuFrame


def pointcloud_ply(points_enu: ArrayLike, colours: NDArray[np.uint8], frame: EnuFrame) -> bytes:
    """A binary .ply of points (n, 3) in ENU metres, as doubles, with colours (n, 3); comments name the origin."""
    xyz = np.asarray(points_enu, dtype=np.float64).reshape(-1, 3)
    vertices = np.empty(len(xyz), dtype=[("xyz", "<f8", 3), ("rgb", "u1", 3)])
    vertices["xyz"], vertices["rgb"] = xyz, colours
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment x east, y north, z up: metres from a local origin, not map coordinates",
        f"comment origin WGS 84 latitude {frame.lat_deg!r} longitude {frame.lon_deg!r}",
        f"comment origin height {frame.height_m!r} m above the WGS 84 ellipsoid",
        f"element vertex {len(xyz)}",
        *(f"property double {axis}" for axis in "xyz"),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
        "end_header\n",
    ]
    return "\n".join(header).encode("ascii") + vertices.tobytes()
