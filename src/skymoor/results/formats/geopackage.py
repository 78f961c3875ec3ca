# SPDX-License-Identifier: Apache-2.0
"""Cameras and their footprints as OGC GeoPackage and as GeoParquet, by GDAL and geopandas."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio.raw
from numpy.typing import NDArray

from skymoor.engines.libraries import require
from skymoor.results.formats.footprints import Footprint
from skymoor.results.tables import CAMERA_COLUMNS, CameraRow

Columns = dict[str, NDArray[Any]]
TEXTS = ("image", "set", "status", "heights")
CAMERAS_CRS, FOOTPRINTS_CRS = "EPSG:4979", "EPSG:4326"


def write_geopackage(path: Path, rows: Sequence[CameraRow], footprints: Sequence[Footprint]) -> None:
    """A .gpkg with the layers `cameras` (3D points, EPSG:4979) and `footprints` (polygons, EPSG:4326), with R-trees.

    EPSG writes these CRSs latitude first; geometries of a GeoPackage are x, y whatever the CRS says: longitude first.
    """
    points = np.array([_point(row) for row in rows], object)
    about = "heights above the WGS 84 ellipsoid, metres"
    _write_layer(path, "cameras", points, "Point Z", CAMERAS_CRS, _columns(rows), about)
    if footprints:
        polygons = np.array([_polygon(one) for one in footprints], object)
        columns = footprint_columns(rows, footprints)
        _write_layer(path, "footprints", polygons, "Polygon", FOOTPRINTS_CRS, columns, "ground that each photo shows")


def write_geoparquet(path: Path, rows: Sequence[CameraRow], footprints: Sequence[Footprint]) -> None:
    """Footprints as a GeoParquet file (1.1): polygons of longitude, latitude with their bounding boxes.

    Raises `BackendUnavailable` where geopandas, shapely or pyarrow is missing.
    """
    require("pyarrow", "export")
    geopandas, shapely = require("geopandas", "export"), require("shapely", "export")
    polygons = [shapely.Polygon(one.outline) for one in footprints]
    table = geopandas.GeoDataFrame(footprint_columns(rows, footprints), geometry=polygons, crs=FOOTPRINTS_CRS)
    table.to_parquet(path, index=False, schema_version="1.1.0", write_covering_bbox=True)


def footprint_columns(rows: Sequence[CameraRow], footprints: Sequence[Footprint]) -> Columns:
    """What is said of each footprint: the columns of its camera, and how the ground is known."""
    of_image = {row.image: row for row in rows}
    columns = _columns([of_image[one.image] for one in footprints])
    columns["surface_share"] = np.array([one.surface_share for one in footprints], np.float64)
    columns["ground_up"] = np.array([one.ground_up for one in footprints], np.float64)
    return columns


def _columns(rows: Sequence[CameraRow]) -> Columns:
    records = [asdict(row) for row in rows]
    return {
        name: np.array([record[name] for record in records], _kind(name))
        for name in CAMERA_COLUMNS
        if name not in ("lat", "lon", "height")
    }


def _kind(name: str) -> type:
    return object if name in TEXTS else np.int64 if name == "component" else np.float64


def _write_layer(
    path: Path, layer: str, wkb: NDArray[Any], kind: str, crs: str, columns: Mapping[str, NDArray[Any]], about: str
) -> None:
    pyogrio.raw.write(
        path,
        geometry=wkb,
        field_data=list(columns.values()),
        fields=list(columns),
        layer=layer,
        driver="GPKG",
        geometry_type=kind,
        crs=crs,
        append=path.exists(),
        layer_options={"GEOMETRY_NAME": "geom", "DESCRIPTION": about, "SPATIAL_INDEX": "YES"},
    )


def _point(row: CameraRow) -> bytes:
    """ISO WKB of a 3D point; z is NaN where the height is not confirmed."""
    return struct.pack("<BIddd", 1, 1001, row.lon, row.lat, float("nan") if row.height is None else row.height)


def _polygon(one: Footprint) -> bytes:
    """WKB of a polygon of one closed ring."""
    ring = np.vstack([one.outline, one.outline[:1]]).astype("<f8")
    return struct.pack("<BIII", 1, 3, 1, len(ring)) + ring.tobytes()
