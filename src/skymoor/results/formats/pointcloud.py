# SPDX-License-Identifier: Apache-2.0
"""Point clouds as LAS 1.4, compressed."""

from __future__ import annotations

import io
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.results.formats._crs import MapFrame

Array32 = NDArray[np.float32]

POINT_FORMAT_WITH_COLOUR = 7
MILLIMETRE_IN_DEGREES = 1e-8


def pointcloud_las(points_enu: ArrayLike, colours: NDArray[np.uint8], frame: EnuFrame, crs: str) -> bytes:
    """A .laz file of points (n, 3) in ENU metres with colours (n, 3), in the map projection `crs`.

    Heights are metres above the WGS 84 ellipsoid. The header's CRS states that; where the map has another ellipsoid, it
    is two-dimensional and leaves heights open. Coordinates are stored to about a millimetre; points that are not
    finite are left out. Raises `InputError` for an unknown CRS.
    """
    enu = np.asarray(points_enu, dtype=np.float64).reshape(-1, 3)
    known = np.isfinite(enu).all(axis=1)
    chart = MapFrame(frame, crs)
    xyz = chart.map_from_enu(enu[known])
    step = MILLIMETRE_IN_DEGREES if chart.is_degrees else 0.001
    header = laspy.LasHeader(point_format=POINT_FORMAT_WITH_COLOUR, version="1.4")
    header.scales = np.array([step, step, 0.001])
    header.offsets = np.floor(xyz.mean(axis=0)) if len(xyz) else np.zeros(3)
    header.generating_software = "skymoor"
    header.add_crs(chart.with_heights)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = xyz.T
    # LAS colours have 16 bits: 257 takes 255 to 65535.
    cloud.red, cloud.green, cloud.blue = np.asarray(colours, np.uint8)[known].astype(np.uint16).T * np.uint16(257)
    out = io.BytesIO()
    cloud.write(out, do_compress=True)
    return out.getvalue()


def read_pointcloud(path: Path, frame: EnuFrame, max_points: int) -> tuple[Array32, NDArray[np.uint8]]:
    """Positions (n, 3) in ENU metres and colours (n, 3) of a file of `pointcloud_las`, evenly thinned out.

    Raises `InputError` when it cannot be read.
    """
    try:
        cloud = laspy.read(path)
        step = max(1, -(-len(cloud.points) // max_points))
        crs = cloud.header.parse_crs()
        if crs is None:
            raise ValueError("it has no coordinate reference system")
        xyz = MapFrame(frame, crs.to_wkt()).enu_from_map(np.asarray(cloud.xyz)[::step])
        colours = np.column_stack([np.asarray(cloud[name])[::step] for name in ("red", "green", "blue")])
    except (OSError, ValueError, RuntimeError, laspy.errors.LaspyException) as error:
        raise InputError(f"{path}: no point cloud of a run ({error}); run skymoor run again") from error
    return xyz.astype(np.float32), (colours // 257).astype(np.uint8)
