# SPDX-License-Identifier: Apache-2.0
"""GeoPackage and GeoParquet, read by SQLite, GDAL, geopandas and pyarrow; footprints against an exact cast."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from pathlib import Path

import geopandas
import numpy as np
import pyogrio
import pytest

from skymoor.geometry import Intrinsics, Similarity
from skymoor.results.export import export
from skymoor.results.formats.footprints import Footprint, footprint, no_heights
from skymoor.results.read import Result
from skymoor.types import Array, Camera
from support.exported_run import FRAME, LENS, cameras, write_run

pyarrow = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("geopackage")
    export(Result.read(write_run(root)), ["gpkg,geoparquet"], root / "out", lambda _: None)
    return root / "out"


def _enu(outline: Array, height: float) -> Array:
    return np.asarray(FRAME.enu_from_lla(outline[:, 1], outline[:, 0], np.full(len(outline), height)))


def _outline(one: Footprint | None) -> Array:
    assert one is not None
    return _enu(one.outline, FRAME.height_m + one.ground_up)


def _camera(rotation: Array, height: float = 80.0) -> Camera:
    lens = Intrinsics(400, 300, 200.0, 200.0, 200.0, 150.0)
    return Camera("a.jpg", lens, Similarity(1.0, rotation, -rotation @ np.array([10.0, 20.0, height])))


DOWN = np.diag([1.0, -1.0, -1.0])


def test_a_footprint_on_a_plane_is_as_large_as_the_picture() -> None:
    found = _outline(footprint(_camera(DOWN), no_heights, 30.0, FRAME))
    half = 50 / 200 * np.array([399 / 2, 299 / 2])  # 50 m above the ground, from the centres of the outer pixels
    np.testing.assert_allclose(found[:, :2].max(axis=0), np.array([10, 20]) + half, atol=0.02)
    np.testing.assert_allclose(found[:, :2].min(axis=0), np.array([10, 20]) - half, atol=0.02)


def test_a_footprint_ends_on_what_stands_in_the_way() -> None:
    wall = 35.0

    def heights(xyz: Array) -> Array:
        return np.where(xyz[:, 0] > wall, 60.0, 30.0)

    found = _outline(footprint(_camera(DOWN), heights, 30.0, FRAME))
    # The outermost ray falls 20 m by x = 30 and 25 m by x = 35: it is then at 55 m, below the roof's 60, on the wall.
    assert found[:, 0].max() == pytest.approx(wall, abs=0.3)
    assert found[:, 0].min() == pytest.approx(10 - 50 / 200 * 399 / 2, abs=0.02)


@pytest.mark.parametrize("tilt", [80, 120])
def test_where_the_horizon_shows_there_is_no_footprint(tilt: float) -> None:
    a = np.radians(tilt)
    rotation = np.array([[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]]) @ DOWN
    assert footprint(_camera(rotation), no_heights, 0.0, FRAME) is None
    assert footprint(_camera(DOWN, height=5.0), no_heights, 9.0, FRAME) is None


def test_geopackage_has_two_layers_with_spatial_indices(out: Path) -> None:
    path = out / "gpkg" / "cameras.gpkg"
    assert {name for name, _ in pyogrio.list_layers(path)} == {"cameras", "footprints"}
    with closing(sqlite3.connect(path)) as base:
        for layer in ("cameras", "footprints"):
            boxes = base.execute(f'SELECT minx, maxx, miny, maxy FROM "rtree_{layer}_geom"').fetchall()
            assert len(boxes) == 4
            assert all(
                -70.26 < west <= east < -70.24 and -33.51 < south <= north < -33.49
                for west, east, south, north in boxes
            )
        rules = base.execute(
            "SELECT table_name FROM gpkg_extensions WHERE extension_name = 'gpkg_rtree_index'"
        ).fetchall()
        assert {name for (name,) in rules} == {"cameras", "footprints"}
        codes = dict(base.execute("SELECT table_name, srs_id FROM gpkg_geometry_columns").fetchall())
    assert codes == {"cameras": 4979, "footprints": 4326}


def test_footprints_lie_below_their_cameras_on_the_surface(out: Path) -> None:
    table = geopandas.read_file(out / "gpkg" / "cameras.gpkg", layer="footprints")
    assert table.geometry.is_valid.all()
    assert table["surface_share"].between(0.1, 0.5).all()  # the run's surface is smaller than a photo
    for polygon, camera, image in zip(table.geometry, cameras()[:4], table["image"], strict=True):
        assert image == camera.image
        ring = np.array(polygon.exterior.coords)[:-1]
        plan = _enu(ring, FRAME.height_m + 3.0)
        # Pixels of the outline on the surface of the run: near the border of the image all the way round.
        up = 3 + np.sin(plan[:, 0] / 9) + plan[:, 1] / 20
        px = LENS.px_from_cam(camera.cam_from_world.apply(np.column_stack([plan[:, :2], up])))
        inside = (np.abs(plan[:, :2]) < 28).all(axis=1)
        edge = np.minimum(np.abs(px), np.abs(px - [LENS.width, LENS.height])).min(axis=1)
        assert inside.any() and edge[inside].max() < 3


def test_geoparquet_is_the_same_with_bounding_boxes(out: Path) -> None:
    path = out / "geoparquet" / "footprints.parquet"
    geo = json.loads(pyarrow.read_schema(path).metadata[b"geo"])
    column = geo["columns"]["geometry"]
    assert geo["version"] == "1.1.0" and column["geometry_types"] == ["Polygon"] and "bbox" in column["covering"]
    found = geopandas.read_parquet(path)
    want = geopandas.read_file(out / "gpkg" / "cameras.gpkg", layer="footprints")
    assert found.crs.to_epsg() == 4326 and list(found["image"]) == list(want["image"])
    assert found.geometry.geom_equals_exact(want.geometry, 1e-12).all()
    assert (found["ce90"] == 2.1).all()
