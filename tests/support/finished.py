# SPDX-License-Identifier: Apache-2.0
"""The folder of a finished run, made up in a moment: what pages and viewers are tried on."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skymoor.geo import EnuFrame, Grid
from skymoor.geometry import Similarity
from skymoor.pipeline.job import ComponentResult
from skymoor.reference.read import read_reference
from skymoor.registration.criteria import criterion
from skymoor.results.formats import cameras_table, georeference, geotiffs, pointcloud_las
from skymoor.results.statistics import component_details, component_statistics, ellipses_of
from skymoor.results.survey import ELLIPSOIDAL
from skymoor.results.tables import CAMERA_COLUMNS, CameraRow
from skymoor.store import plain
from skymoor.types import Registration
from support.blocks import block

HOSTILE = '<script>alert(1)</script> & Überführung "7" 駅'
CRS = "EPSG:32632"
COMPETING = "a competing hypothesis scores 85, the best 90; at least 110.5 is required"


def finished_run(folder: Path, *, cameras: int = 9, registered: bool = True, former: bool = False) -> Path:
    """Write a run of an airborne set, a ground set with two components and one that was lost; returns its folder.

    A `former` one is of a version that did not record the figures of the survey.
    """
    run = folder / "run"
    for name in ("matches", "renders"):
        (run / name).mkdir(parents=True)
    grid = Grid(-40.0, 40.0, 1.0, (80, 80))
    rng = np.random.default_rng(3)
    rgb = cv2.resize(rng.integers(0, 255, (10, 10, 3), np.uint8), (80, 80), interpolation=cv2.INTER_CUBIC)
    height = cv2.resize(rng.uniform(0, 8, (10, 10)).astype(np.float32), (80, 80))
    frame = EnuFrame(48.0, 11.0, 500.0)
    sure = np.full((80, 80), 90, np.uint8)
    names = ("ortho.tif", "dsm.tif")
    for path, content in zip(names, geotiffs(rgb, height, sure, grid, frame, CRS), strict=False):
        (folder / path).write_bytes(content)
    reference = read_reference(folder / "ortho.tif", folder / "dsm.tif", "ellipsoid", np.diag([1.0, 1.0, 2.0]))
    model = np.where(np.hypot(*np.indices((80, 80)) - 40.0) < 25, height + 0.5, np.nan).astype(np.float32)
    if registered:
        _write_model(run, rgb, model, grid, frame)
    _write_pictures(run, rgb, rng)
    rows = _rows(folder, reference.frame, cameras, registered=registered)
    with (run / "cameras.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, CAMERA_COLUMNS)
        writer.writeheader()
        writer.writerows(cameras_table(rows))
    summary = summary_of_run(folder, reference.frame, cameras, registered=registered)
    if not former:
        _record_survey(run, summary, registered=registered)
    (run / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    return run


def _record_survey(run: Path, summary: dict[str, Any], *, registered: bool) -> None:
    """What a run records of its reconstruction, here of nine nadir photos."""
    whole = block("nadir", relief_m=4.0, n=300)
    seen = whole.of_cameras(np.arange(len(whole.cameras)) < 9)
    renamed = tuple(replace(one, image=f"air/{k:03d}.jpg") for k, one in enumerate(seen.cameras))
    placed = Registration(registered, "", Similarity.identity() if registered else None)
    item = ComponentResult("airborne-0", replace(seen, cameras=renamed), Similarity.identity(), placed)
    images = [camera.image for camera in renamed]
    total, relative = np.diag([0.9, 0.4, 1.0]), np.diag([0.01, 0.02, 0.05])
    ellipses = ellipses_of(images, *(np.tile(one, (len(images), 1, 1)) for one in (total, relative)))
    details = {"airborne_0": component_details(item, ellipses if registered else {})}
    (run / "statistics.json").write_text(json.dumps(plain(details)), encoding="utf-8")
    air = summary["sets"][0]["components"][0]
    (first,) = air["hypotheses"]
    second = {"score": 65.0, "east": 31.0, "north": -38.0, "azimuth_deg": 187.0}
    air["hypotheses"] = [first | {"distance_m": 0.0}, first | second | {"distance_m": 50.0}]
    air["statistics"] = plain(component_statistics(item))
    covariances = {"covariance_m2": np.diag([0.8, 0.8, 4.5]), "relative_covariance_m2": np.diag([0.002, 0.002, 0.06])}
    figures = {"ce90_m": 1.9, "le90_m": 3.5, "relative_ce90_m": 0.1, "relative_le90_m": 0.4}
    air["surface_accuracy"] = plain(covariances | figures)
    systems = {"crs": {"name": "WGS 84 / UTM zone 32N", "epsg": 32632}, "heights": ELLIPSOIDAL}
    summary["coordinate_systems"] = systems | {"reference_heights": {"name": "EGM2008 height", "epsg": 3855}}
    summary |= {"date": "2026-11-02T10:20:30+00:00", "seconds": 75.0}
    summary["search"] = {"bounds_m": [-40.0, -40.0, 40.0, 40.0], "area_m2": 6400.0, "limited": False}


def _write_model(run: Path, rgb: Any, model: Any, grid: Grid, frame: EnuFrame) -> None:
    names, sure = ("ortho.tif", "dsm.tif", "confidence.tif"), np.full((80, 80), 90, np.uint8)
    for path, content in zip(names, geotiffs(rgb, model, sure, grid, frame, CRS), strict=True):
        (run / path).write_bytes(content)
    points = np.concatenate([grid.centres(), model[..., None]], axis=-1).reshape(-1, 3)
    (run / "pointcloud.laz").write_bytes(pointcloud_las(points, rgb.reshape(-1, 3), frame, CRS))


def _write_pictures(run: Path, rgb: Any, rng: np.random.Generator) -> None:
    for name in ("renders/airborne_0_nadir_rgb", "matches/airborne_0_matches", "matches/ground0_0_walls"):
        assert cv2.imwrite(str(run / f"{name}.png"), rgb)
    residuals, inliers = rng.normal(0, 0.3, (200, 3)), np.ones(200, bool)
    np.savez(run / "matches" / "airborne_0.npz", residuals_m=residuals, inliers=inliers)


def _rows(folder: Path, frame: EnuFrame, count: int, *, registered: bool) -> list[CameraRow]:
    (folder / "air").mkdir()
    rows = []
    for k in range(count):
        name = f"air/{k:03d}.jpg" if k else "air/<b>ä & 駅.jpg"
        assert cv2.imwrite(str(folder / name), np.full((30, 40, 3), 90, np.uint8))
        east, north, up = 20 * np.cos(k), 20 * np.sin(k), 40.0
        lat, lon, height = frame.lla_from_enu([[east, north, up]])[0]
        place = (lat, lon, height, east, north, up, 0.0, 1.0, 0.0, 0.0, 2.1, 3.8, 0.2, 0.9)
        status = "REGISTERED" if registered else "NOT_REGISTERED"
        rows.append(CameraRow(name, "airborne", 0, status, *(map(float, place) if registered else ())))
    return [*rows, CameraRow("wall/1.jpg", "ground0", 0, "NOT_REGISTERED")]


def summary_of_run(folder: Path, frame: EnuFrame, cameras: int, *, registered: bool) -> dict[str, Any]:
    status = "REGISTERED" if registered else "NOT_REGISTERED"
    air: dict[str, Any] = {
        **{"component": 0, "status": status, "reason": "" if registered else COMPETING},
        **{"n_cameras": cameras, "n_matches": 200, "n_inliers": 190, "rmse_m": 0.3, "reprojection_px": 0.4},
        **{"tilt_deg": 0.2, "calibration_note": "", "contradicting_cameras": [], "diagnostics": {}},
        "criteria": [asdict(criterion("competing_score", 90.0, 65.0 if registered else 110.5))],
    }
    place = {"lat": 48.0, "lon": 11.0, "east": 1.0, "north": 2.0}
    air["hypotheses"] = [{"score": 90.0, **place, "azimuth_deg": 3.0, "metres_per_unit": 12.0}]
    if registered:
        air |= georeference(frame, Similarity.identity())
        air |= {"predicted_ce90_m": 2.1, "predicted_le90_m": 3.8}
        air |= {"predicted_relative_ce90_m": 0.2, "predicted_relative_le90_m": 0.9}
    wall = {"component": 0, "status": "NOT_REGISTERED", "reason": "no wall fits", "n_cameras": 1}
    wall["criteria"] = [asdict(criterion("wall_hypotheses", 0, 1))]
    files = {"ortho": str(folder / "ortho.tif"), "dsm": str(folder / "dsm.tif"), "vertical_datum": "ellipsoid"}
    return {
        **{"skymoor": "0.1.0", "site": HOSTILE, "seed": 0, "options": {"match": {"matcher": "structural"}}},
        "reference": {**files, "covariance_m2": np.diag([1.0, 1.0, 2.0]).tolist()},
        "enu_origin": {"lat": frame.lat_deg, "lon": frame.lon_deg, "height": frame.height_m},
        "provenance": {"python": "3.11"},
        "sets": [
            {"set": "airborne", "status": status, "reason": "", "folder": str(folder / "air"), "components": [air]},
            {"set": "ground0", "status": "NOT_REGISTERED", "reason": "", "components": [wall, wall | {"component": 1}]},
            {"set": "ground1", "status": "NOT_REGISTERED", "reason": "no two photos agree", "components": []},
        ],
        "stages": [{"name": "photos", "key": "0", "seconds": 75.0, "peak_mib": 400.0, "cached": False}],
    }
