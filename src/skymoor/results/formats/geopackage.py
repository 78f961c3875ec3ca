# SPDX-License-Identifier: Apache-2.0
"""Cameras as an OGC GeoPackage, which is a SQLite database."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict

from pyproj import CRS
from pyproj.enums import WktVersion

from skymoor.results.tables import CameraRow

APPLICATION_ID, VERSION = 0x47504B47, 10300  # "GPKG", 1.3
SRS = 4979
_TABLES = """
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY, organization TEXT NOT NULL,
  organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT,
  definition_12_063 TEXT NOT NULL DEFAULT 'undefined', epoch DOUBLE);
CREATE TABLE gpkg_extensions (table_name TEXT, column_name TEXT, extension_name TEXT NOT NULL,
  definition TEXT NOT NULL, scope TEXT NOT NULL,
  CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name));
INSERT INTO gpkg_extensions VALUES ('gpkg_spatial_ref_sys', 'definition_12_063', 'gpkg_crs_wkt_1_1',
  'http://www.geopackage.org/spec/#extension_crs_wkt', 'read-write');
INSERT INTO gpkg_extensions VALUES ('gpkg_spatial_ref_sys', 'epoch', 'gpkg_crs_wkt_1_1',
  'http://www.geopackage.org/spec/#extension_crs_wkt', 'read-write');
CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '', last_change DATETIME NOT NULL DEFAULT '1970-01-01T00:00:00.000Z',
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER);
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL, geometry_type_name TEXT NOT
  NULL, srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
  CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name));
INSERT INTO gpkg_geometry_columns VALUES ('cameras', 'geom', 'POINT', 4979, 1, 0);
"""


def cameras_geopackage(rows: Sequence[CameraRow]) -> bytes:
    """A .gpkg with the layer `cameras` of registered cameras: 3D points in EPSG:4979, heights above the ellipsoid.

    EPSG writes that CRS latitude first; a GeoPackage's points are x, y whatever the CRS says: longitude first.
    """
    with closing(sqlite3.connect(":memory:")) as base:
        base.executescript(_TABLES)
        crs = CRS.from_epsg(SRS)
        systems = [
            ("Undefined Cartesian", -1, "NONE", -1, "undefined", "undefined"),
            ("Undefined geographic", 0, "NONE", 0, "undefined", "undefined"),
            *((known.name, code, "EPSG", code, "undefined" if code == SRS else known.to_wkt(WktVersion.WKT1_GDAL),
               known.to_wkt()) for code, known in ((4326, CRS.from_epsg(4326)), (SRS, crs))),
        ]  # fmt: skip
        base.executemany(
            "INSERT INTO gpkg_spatial_ref_sys (srs_name, srs_id, organization, organization_coordsys_id, definition, "
            "definition_12_063) VALUES (?, ?, ?, ?, ?, ?)",
            systems,
        )
        _add_cameras(base, rows)
        base.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        base.execute(f"PRAGMA user_version = {VERSION}")
        base.commit()
        return base.serialize()


def _add_cameras(base: sqlite3.Connection, rows: Sequence[CameraRow]) -> None:
    records = [asdict(row) for row in rows]
    names = [name for name in asdict(CameraRow("", "", None, "")) if name not in ("lat", "lon", "height")]
    kinds = {"image": "TEXT", "set": "TEXT", "status": "TEXT", "heights": "TEXT", "component": "INTEGER"}
    columns = ", ".join(f'"{name}" {kinds.get(name, "DOUBLE")}' for name in names)
    base.execute(f"CREATE TABLE cameras (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom POINT, {columns})")
    marks = ", ".join("?" * (len(names) + 1))
    quoted = ", ".join(f'"{name}"' for name in names)
    base.executemany(
        f"INSERT INTO cameras (geom, {quoted}) VALUES ({marks})",
        [(_point(one["lon"], one["lat"], one["height"]), *(one[name] for name in names)) for one in records],
    )
    lons, lats = ([one[name] for one in records] for name in ("lon", "lat"))
    extent = [min(lons), min(lats), max(lons), max(lats)] if records else [None] * 4
    base.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, min_x, min_y, max_x, max_y, srs_id)"
        " VALUES ('cameras', 'features', 'cameras', 'heights above the WGS 84 ellipsoid, metres', ?, ?, ?, ?, ?)",
        (*extent, SRS),
    )


def _point(x: float, y: float, height: float | None) -> bytes:
    """The header of GeoPackage (little-endian, without envelope), then ISO WKB of a 3D point; z may be NaN."""
    z = float("nan") if height is None else height
    return struct.pack("<2sBBi", b"GP", 0, 1, SRS) + struct.pack("<BIddd", 1, 1001, x, y, z)
