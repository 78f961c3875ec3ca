# SPDX-License-Identifier: Apache-2.0
"""The formats by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from skymoor.results.formats import _of_cameras, _of_photos, _of_surfaces
from skymoor.results.formats._source import Source

FORMATS: dict[str, Callable[[Source, Path], str]] = {
    "colmap": _of_photos.colmap,
    "nerfstudio": _of_photos.nerfstudio,
    "laz": _of_surfaces.laz,
    "copc": _of_surfaces.copc,
    "cog": _of_surfaces.cog,
    "geojson": _of_cameras.geojson,
    "gpkg": _of_cameras.gpkg,
    "geoparquet": _of_cameras.geoparquet,
    "kml": _of_cameras.kml,
    "ply": _of_surfaces.ply,
    "gltf": _of_surfaces.gltf,
    "3dtiles": _of_surfaces.tiles,
    "stac": _of_surfaces.stac,
    "odm": _of_cameras.odm,
    "tum": _of_cameras.tum,
    "metashape": _of_cameras.metashape,
    "realityscan": _of_cameras.realityscan,
    "opf": _of_photos.opf,
    # Last: they cannot do without the photos.
    "splat-training": _of_photos.splat_training,
    "exif": _of_photos.exif,
}
"""What writes a format into an empty folder, and returns what its heights are."""
