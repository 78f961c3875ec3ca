# SPDX-License-Identifier: Apache-2.0
"""The whole job through the command line, on a small site of which the truth is known."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from scene import make_scene
from sharing import shared
from sitefiles import BIAS_M, COVARIANCE, FRAME, write_reference
from skymoor.cli import main

pytestmark = pytest.mark.e2e

Array = NDArray[np.float64]
# Narrower than the defaults, to save time; the flight is 64 m above ground.
FASTER = (
    "--set",
    "match.min_height_m=42",
    "--set",
    "match.max_height_m=100",
    "--set",
    "reconstruct.matcher.max_features=2500",
)


def run_site(site: Path, out: Path, *more: str) -> int:
    return main(["run", str(site), "--out", str(out), "--seed", "3", "--quiet", *FASTER, *more])


def summary_of(out: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return summary


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def true_enu(site_dir: Path) -> dict[str, Array]:
    """Camera centres in the site's own frame."""
    rows = rows_of(site_dir / "truth.csv")
    enu = FRAME.enu_from_lla(*(np.array([float(row[k]) for row in rows]) for k in ("lat", "lon", "height")))
    return {row["image"]: centre for row, centre in zip(rows, enu, strict=True)}


def computed_stages(out: Path) -> set[str]:
    return {stage["name"] for stage in summary_of(out)["stages"] if not stage["cached"]}


@pytest.fixture(scope="module")
def finished(site_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A first run, registered; do not write into it."""

    def make() -> Path:
        out = tmp_path_factory.mktemp("run") / "out"
        assert run_site(site_dir / "site.toml", out) == 0
        return out

    return shared(tmp_path_factory, "run", make)


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    """A copy of the run to go on with."""
    return Path(shutil.copytree(finished, tmp_path / "out"))


def test_every_camera_is_where_the_reference_says(finished: Path, site_dir: Path) -> None:
    truth = true_enu(site_dir)
    rows = rows_of(finished / "cameras.csv")
    assert sorted(row["image"] for row in rows) == sorted(truth)
    assert {row["status"] for row in rows} == {"REGISTERED"} and {row["component"] for row in rows} == {"0"}
    lla = [np.array([float(row[k]) for row in rows]) for k in ("lat", "lon", "height")]
    error = FRAME.enu_from_lla(*lla) - [truth[row["image"]] for row in rows]
    # The reference is off by a known bias, and so must the result be: 70 m above ground a degree is 1.2 m.
    np.testing.assert_allclose(error.mean(axis=0), BIAS_M, atol=0.25)
    relative = np.linalg.norm(error - error.mean(axis=0), axis=1)
    assert 0.001 < relative.mean() < 0.005 * 84
    assert relative.max() < 0.01 * 84
    enu = np.array([[float(row[k]) for k in ("east", "north", "up")] for row in rows])
    offsets = enu - FRAME.enu_from_lla(*lla)
    assert np.ptp(offsets, axis=0).max() < 0.01  # the run has an origin of its own, with parallel axes here


def test_summary_says_how_well(finished: Path) -> None:
    summary = summary_of(finished)
    (found,) = summary["sets"]
    (component,) = found["components"]
    assert found["status"] == component["status"] == "REGISTERED"
    assert component["n_cameras"] == 18
    assert component["n_inliers"] > 1000 and component["inlier_ratio"] > 0.8
    assert 0.02 < component["rmse_m"] < 0.4
    assert component["tilt_deg"] < 1.0
    assert component["enu_from_sfm"]["scale"] > 0
    assert summary["seed"] == 3 and summary["options"]["match"]["max_height_m"] == 100
    # CE90 of the reference alone is 2.146 * 0.71 m; registration and focal length add to it.
    assert 1.5 < component["predicted_ce90_m"] < 1.9
    assert 1.645 * np.sqrt(COVARIANCE[2, 2]) < component["predicted_le90_m"] < 3.5
    assert all(stage["seconds"] >= 0 and stage["peak_mib"] > 0 for stage in summary["stages"])


def test_evaluation(copied: Path, site_dir: Path) -> None:
    assert main(["evaluate", str(copied), "--truth", str(site_dir / "truth.csv")]) == 0
    (row,) = json.loads((copied / "evaluation.json").read_text())["rows"]
    assert row["n_cameras"] == 18 and row["status"] == "REGISTERED"
    assert row["mean_absolute_m"] == pytest.approx(np.linalg.norm(BIAS_M), abs=0.25)
    assert row["mean_relative_m"] < 0.005 * row["standoff_m"]
    assert row["standoff_m"] == pytest.approx(84, abs=4)
    # The bias is 0.4, 0.3 and 0.5 m; the reference claims 0.7, 0.7 and 0.9 m.
    assert 0.4 < row["mahalanobis_of_mean"] < 1.5


def test_products_lie_on_the_reference(finished: Path, site_dir: Path) -> None:
    with rasterio.open(finished / "dsm.tif") as mine, rasterio.open(site_dir / "reference/dsm.tif") as theirs:
        assert mine.crs == theirs.crs
        place = mine.transform
        heights, known = mine.read(1), mine.read_masks(1) > 0
        rows, columns = (index[::7] for index in np.nonzero(known))
        x, y = place.c + (columns + 0.5) * place.a, place.f + (rows + 0.5) * place.e
        reference = np.array([value[0] for value in theirs.sample(np.column_stack([x, y]))])
    assert 0.1 < known.mean() < 0.5  # the reference is much larger than the flight
    difference = (heights[rows, columns] - reference)[reference > -9000]
    assert len(difference) > 1000
    assert abs(np.median(difference)) < 0.15
    assert 0.02 < np.median(np.abs(difference)) < 0.3
    with rasterio.open(finished / "ortho.tif") as ortho:
        assert ortho.crs == theirs.crs and ortho.count >= 3
    assert (finished / "pointcloud.laz").stat().st_size > 10_000
    assert (finished / "colmap/airborne_0/georeference.json").exists()


def test_a_second_run_is_served_from_the_cache(copied: Path, site_dir: Path) -> None:
    before = (copied / "cameras.csv").read_text()
    assert run_site(site_dir / "site.toml", copied) == 0
    assert computed_stages(copied) == set()
    assert (copied / "cameras.csv").read_text() == before


def test_a_changed_option_redoes_only_what_depends_on_it(copied: Path, site_dir: Path) -> None:
    assert run_site(site_dir / "site.toml", copied, "--set", "register.min_score=500") == 3
    assert computed_stages(copied) == {"airborne-0.register"}
    (component,) = summary_of(copied)["sets"][0]["components"]
    assert component["status"] == "NOT_REGISTERED" and "500" in component["reason"]


def test_a_decoy_reference_is_refused(copied: Path, site_dir: Path, tmp_path: Path) -> None:
    (copied / "evaluation.json").write_text("{}")
    write_reference(tmp_path / "decoy", make_scene(3, sun_deg=(205.0, 40.0)))
    arguments = ["run", "--airborne", str(site_dir / "airborne"), "--out", str(copied), "--seed", "3", "--quiet"]
    arguments += ["--ortho", str(tmp_path / "decoy/ortho.tif"), "--dsm", str(tmp_path / "decoy/dsm.tif")]
    arguments += ["--vertical-datum", "ellipsoid", "--ce90", "2.5", "--le90", "3.8", *FASTER]
    assert main(arguments) == 3
    summary = summary_of(copied)
    (component,) = summary["sets"][0]["components"]
    assert summary["sets"][0]["status"] == component["status"] == "NOT_REGISTERED"
    assert component["reason"] and "enu_from_sfm" not in component
    rows = rows_of(copied / "cameras.csv")
    assert len(rows) == 18
    for row in rows:
        assert row["status"] == "NOT_REGISTERED"
        assert not any(row[key] for key in ("lat", "lon", "height", "east", "north", "up", "qw", "ce90", "le90"))
    # Nothing of the run before may be left that looks like a result.
    for name in ("pointcloud.laz", "ortho.tif", "dsm.tif", "evaluation.json"):
        assert not (copied / name).exists(), name
    assert "reconstruct" not in computed_stages(copied)
