# SPDX-License-Identifier: Apache-2.0
"""Products of a finished run, made in memory: the caller writes them."""

from skymoor.engines.colmap import colmap_from_component as colmap_model
from skymoor.results.formats._crs import enu_from_map
from skymoor.results.formats.cameras import (
    cameras_geojson,
    cameras_table,
    georeference,
    placed_cameras,
    unplaced_cameras,
)
from skymoor.results.formats.cog import write_cog
from skymoor.results.formats.exif import photo_with_position
from skymoor.results.formats.gltf import height_field, mesh_glb, tileset
from skymoor.results.formats.kml import cameras_kml
from skymoor.results.formats.nerfstudio import nerfstudio_transforms
from skymoor.results.formats.odm import odm_gcp_list, odm_geo
from skymoor.results.formats.ply import pointcloud_ply
from skymoor.results.formats.pointcloud import pointcloud_las, read_pointcloud
from skymoor.results.formats.raster import geotiffs
from skymoor.results.formats.xmp import position_xmp

__all__ = [
    "cameras_geojson",
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
