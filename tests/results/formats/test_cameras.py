# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skymoor.geo import EnuFrame
from skymoor.geometry import Intrinsics, Similarity
from skymoor.results.formats import (
    cameras_geojson,
    cameras_table,
    georeference,
    placed_cameras,
    unplaced_cameras,
)
from skymoor.results.tables import CAMERA_COLUMNS, CameraRow, read_cameras_csv
from skymoor.store import Store
from skymoor.types import Camera

FRAME = EnuFrame(46.5, 7.5, 600.0)
INTRINSICS = Intrinsics(640, 480, 500.0, 500.0, 320.0, 240.0)


@pytest.fixture
def cameras() -> list[Camera]:
    rng = np.random.default_rng(0)
    rotations = Rotation.random(3, rng=rng).as_matrix()
    centres = rng.uniform(-100, 100, (3, 3))
    return [
        Camera(f"air/{k}.jpg", INTRINSICS, Similarity(1.0, rotation, -rotation @ centre))
        for k, (rotation, centre) in enumerate(zip(rotations, centres, strict=True))
    ]


@pytest.fixture
def rows(cameras: list[Camera]) -> list[CameraRow]:
    return [
        *placed_cameras("airborne", 0, cameras, FRAME, [[k, 4.0, 0.1 * k, 0.4] for k in (1, 2, 3)]),
        *unplaced_cameras("walk", None, ["w.jpg"]),
    ]


def test_columns_are_those_of_the_contract() -> None:
    names = "image,set,component,status,lat,lon,height,east,north,up,qw,qx,qy,qz,ce90,le90,relative_ce90,relative_le90"
    names += ",heights"
    assert ",".join(CAMERA_COLUMNS) == names


def test_csv_says_where_the_cameras_are(cameras: list[Camera], rows: list[CameraRow], tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        path = store.write_csv("cameras.csv", CAMERA_COLUMNS, cameras_table(rows))
    with path.open(newline="") as file:
        read = list(csv.DictReader(file))
    for camera, line in zip(cameras, read, strict=False):
        quaternion = [float(line[name]) for name in ("qw", "qx", "qy", "qz")]
        assert Rotation.from_quat(quaternion, scalar_first=True).as_matrix() == pytest.approx(
            camera.cam_from_world.rotation
        )
        assert [float(line[name]) for name in ("east", "north", "up")] == pytest.approx(camera.centre)
        lla = [float(line[name]) for name in ("lat", "lon", "height")]
        assert FRAME.enu_from_lla(*lla)[0] == pytest.approx(camera.centre, abs=1e-6)
    assert [line["ce90"] for line in read] == ["1.0", "2.0", "3.0", ""]
    assert [line["le90"] for line in read] == ["4.0", "4.0", "4.0", ""]
    assert list(read[3].values()) == ["w.jpg", "walk", "", "NOT_REGISTERED", *[""] * 15]
    estimates = read_cameras_csv(path)
    assert [estimate.component for estimate in estimates] == [0, 0, 0, None]
    assert estimates[1].lat == rows[1].lat


def test_heights_that_are_not_confirmed_are_not_written(cameras: list[Camera], tmp_path: Path) -> None:
    rows = placed_cameras("airborne", 0, cameras, FRAME, (2.0, 4.0, 0.1, 0.4), "NOT_CONFIRMED")
    for row in rows:
        assert (row.height, row.le90, row.relative_le90, row.heights) == (None, None, None, "NOT_CONFIRMED")
        assert None not in (row.lat, row.lon, row.up, row.ce90)
    for feature in cameras_geojson(rows)["features"]:  # type: ignore[attr-defined]
        assert len(feature["geometry"]["coordinates"]) == 2
    with Store.open(tmp_path) as store:
        path = store.write_csv("cameras.csv", CAMERA_COLUMNS, cameras_table(rows))
    assert [(one.height, one.le90, one.heights) for one in read_cameras_csv(path)] == [
        (None, None, "NOT_CONFIRMED")
    ] * 3
    confirmed = placed_cameras("airborne", 0, cameras, FRAME, (2.0, 4.0, 0.1, 0.4), "CONFIRMED")
    assert confirmed[0].height is not None and confirmed[0].le90 == 4.0


def test_geojson_has_longitude_first(cameras: list[Camera], rows: list[CameraRow]) -> None:
    collection = json.loads(json.dumps(cameras_geojson(rows), allow_nan=False))
    assert collection["type"] == "FeatureCollection"
    assert len(collection["features"]) == 4
    for camera, feature in zip(cameras, collection["features"], strict=False):
        lon, lat, height = feature["geometry"]["coordinates"]
        assert FRAME.enu_from_lla(lat, lon, height)[0] == pytest.approx(camera.centre, abs=1e-6)
        assert feature["properties"]["image"] == camera.image
    unplaced = collection["features"][3]
    assert unplaced["geometry"] is None
    assert unplaced["properties"]["status"] == "NOT_REGISTERED"


def test_no_cameras() -> None:
    assert placed_cameras("airborne", 0, [], FRAME, [1.0, 1.0, 0.1, 0.1]) == []


def test_georeference_gives_the_transform_back() -> None:
    enu_from_sfm = Similarity(2.5, Rotation.from_euler("xyz", [1, 2, 3]).as_matrix(), np.array([1.0, 2.0, 3.0]))
    beside = json.loads(json.dumps(georeference(FRAME, enu_from_sfm)))
    entry = beside["enu_from_sfm"]
    again = Similarity.from_quaternion_wxyz(entry["scale"], entry["quaternion_wxyz"], entry["translation_m"])
    np.testing.assert_allclose(again.matrix(), enu_from_sfm.matrix(), atol=1e-12)
    assert beside["enu_origin"] == {"lat": 46.5, "lon": 7.5, "height": 600.0}
