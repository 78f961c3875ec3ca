# SPDX-License-Identifier: Apache-2.0
"""A small finished run, with exact observations, for the exports."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from skymoor.engines.colmap import write_colmap
from skymoor.geo import EnuFrame, Grid
from skymoor.geometry import Intrinsics, Similarity
from skymoor.results.formats import (
    cameras_table,
    georeference,
    geotiffs,
    placed_cameras,
    pointcloud_las,
    unplaced_cameras,
)
from skymoor.results.tables import CAMERA_COLUMNS
from skymoor.types import Array, Camera, Component

FRAME = EnuFrame(-33.5, -70.25, 612.25)  # south and west: signs are a trap too
LENS = Intrinsics(320, 240, 260.0, 262.0, 163.0, 118.0, (-0.05, 0.01, 0.001, -0.002))


def points() -> Array:
    """Of the scene, (60, 3) ENU metres."""
    rng = np.random.default_rng(5)
    return np.column_stack([rng.uniform(-30, 30, (60, 2)), rng.uniform(0, 8, 60)])


def cameras() -> tuple[Camera, ...]:
    """Five, looking down; the fourth photo is no JPEG."""
    found = []
    for k in range(5):
        angle = np.radians(7.0 * k + 20)
        turn, lean = np.diag([1.0, -1.0, -1.0]), np.radians(6.0 * (k - 2))
        spin = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        tilt = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
        rotation, centre = tilt @ turn @ spin, np.array([6.0 * k - 12, 3.0 * k - 6, 70.0 + k])
        suffix = "png" if k == 3 else "jpg"
        found.append(Camera(f"air/p{k}.{suffix}", LENS, Similarity(1.0, rotation, -rotation @ centre)))
    return tuple(found)


def component() -> Component:
    """The model: every point that lies within a picture, seen exactly."""
    posed, xyz = cameras(), points()
    px = np.array([LENS.px_from_cam(camera.cam_from_world.apply(xyz)) for camera in posed])
    seen = ((px > 0) & (px < [LENS.width, LENS.height])).all(axis=2)
    camera, point = np.nonzero(seen)
    assert seen.sum() > 150
    colours = np.full((len(xyz), 3), 90, np.uint8)
    return Component(posed, xyz, colours, camera.astype(np.int32), point.astype(np.int32), px[seen], 0.0)


def _write_photos(folder: Path) -> None:
    folder.mkdir(parents=True)
    picture = np.random.default_rng(1).integers(0, 255, (LENS.height, LENS.width, 3), np.uint8)
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = "Acme"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.ISOSpeedRatings] = 200
    for camera in cameras():
        name = camera.image.rpartition("/")[2]
        Image.fromarray(picture).save(folder / name, **({"exif": exif} if name.endswith("jpg") else {}))


def write_run(root: Path) -> Path:
    """A finished run of five photos, of which the last is in the model and has no place."""
    folder = root / "run"
    folder.mkdir()
    _write_photos(root / "air")
    model = component()
    (folder / "colmap" / "airborne_0").mkdir(parents=True)
    write_colmap(model, folder / "colmap" / "airborne_0")
    grid = Grid(-30.0, 30.0, 0.5, (120, 120))
    plan = grid.centres()
    up = (3 + np.sin(plan[..., 0] / 9) + plan[..., 1] / 20).astype(np.float32)
    up[:5] = np.nan
    rgb = np.dstack([np.full(up.shape, grey, np.uint8) for grey in (200, 100, 50)])
    ortho, dsm, confidence = geotiffs(rgb, up, np.full(up.shape, 80, np.uint8), grid, FRAME, "EPSG:32719")
    (folder / "ortho.tif").write_bytes(ortho)
    (folder / "dsm.tif").write_bytes(dsm)
    (folder / "confidence.tif").write_bytes(confidence)
    cloud = pointcloud_las(model.points, model.colours, FRAME, "EPSG:32719")
    (folder / "pointcloud.laz").write_bytes(cloud)
    rows = placed_cameras("airborne", 0, model.cameras[:4], FRAME, [2.1, 3.8, 0.1, 0.2])
    rows += unplaced_cameras("airborne", 0, ["air/p4.jpg"])
    with (folder / "cameras.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, CAMERA_COLUMNS)
        writer.writeheader()
        writer.writerows(cameras_table(rows))
    part = {"component": 0, "status": "REGISTERED", "reason": ""} | georeference(FRAME, Similarity.identity())
    sets = [{"set": "airborne", "folder": str(root / "air"), "status": "REGISTERED", "components": [part]}]
    origin = part["enu_origin"]
    summary = {"reference": {"covariance_m2": np.eye(3).tolist()}, "enu_origin": origin, "sets": sets}
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder
