# SPDX-License-Identifier: Apache-2.0
"""Products of a finished run, made in memory: the caller writes them."""

from skymoor.colmap import colmap_from_component as colmap_model
from skymoor.export._crs import enu_from_map
from skymoor.export.cameras import (
    CAMERA_COLUMNS,
    CameraRow,
    cameras_geojson,
    cameras_table,
    georeference,
    placed_cameras,
    unplaced_cameras,
)
from skymoor.export.cog import write_cog
from skymoor.export.exif import photo_with_position, position_xmp
from skymoor.export.geopackage import cameras_geopackage
from skymoor.export.gltf import height_field, mesh_glb, tileset
from skymoor.export.kml import cameras_kml
from skymoor.export.nerfstudio import nerfstudio_transforms
from skymoor.export.odm import odm_gcp_list, odm_geo
from skymoor.export.ply import pointcloud_ply
from skymoor.export.pointcloud import pointcloud_las, read_pointcloud
from skymoor.export.raster import geotiffs

__all__ = [
    "CAMERA_COLUMNS",
    "CameraRow",
    "cameras_geojson",
    "cameras_geopackage",
    "cameras_kml",
    "cameras_table",
    "colmap_model",
    "enu_from_map",
    "georeference",
    "geotiffs",
    "height_field",
    "mesh_glb",
    "nerfstudio_transforms",
    "odm_gcp_list",
    "odm_geo",
    "photo_with_position",
    "placed_cameras",
    "pointcloud_las",
    "pointcloud_ply",
    "position_xmp",
    "read_pointcloud",
    "tileset",
    "unplaced_cameras",
    "write_cog",
]
