# SPDX-License-Identifier: Apache-2.0
"""Products of a finished run, made in memory: the caller writes them."""

from skymoor.colmap import colmap_from_component as colmap_model
from skymoor.export.cameras import (
    CAMERA_COLUMNS,
    CameraRow,
    cameras_geojson,
    cameras_table,
    georeference,
    placed_cameras,
    unplaced_cameras,
)
from skymoor.export.pointcloud import pointcloud_las, read_pointcloud
from skymoor.export.raster import geotiffs

__all__ = [
    "CAMERA_COLUMNS",
    "CameraRow",
    "cameras_geojson",
    "cameras_table",
    "colmap_model",
    "georeference",
    "geotiffs",
    "placed_cameras",
    "pointcloud_las",
    "read_pointcloud",
    "unplaced_cameras",
]
