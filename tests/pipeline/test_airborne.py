# SPDX-License-Identifier: Apache-2.0
"""The whole job through the command line, on a small site of which the truth is known."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from skymoor.cli.main import main
from skymoor.geo import EnuFrame, mahalanobis
from skymoor.model.nerf import Sizes
from skymoor.model.nerf.options import NerfOptions
from skymoor.simulate.plan import dates_of
from skymoor.simulate.satellite import ACCURACY_M, make_reference
from skymoor.simulate.site import Site
from support.flight import OPTIONS, STANDOFF_M, SmallWorld
from support.small_run import FASTER, rows_of, run, summary_of

pytestmark = pytest.mark.e2e

Array = NDArray[np.float64]
PLACE = ("lat", "lon", "height", "east", "north", "up", "qw", "ce90", "le90")


def computed_stages(out: Path) -> set[str]:
    return {stage["name"] for stage in summary_of(out)["stages"] if not stage["cached"]}


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    """A copy of the run to go on with."""
    return Path(shutil.copytree(finished, tmp_path / "out"))


def test_every_camera_is_where_the_reference_says(finished: Path, small_site: Site) -> None:
    rows = rows_of(finished / "cameras.csv")
    airborne = sorted(name for name in small_site.cameras if name.startswith("airborne/"))
    assert sorted(row["image"] for row in rows) == airborne
    assert {row["status"] for row in rows} == {"REGISTERED"} and {row["component"] for row in rows} == {"0"}
    lla = [np.array([float(row[k]) for row in rows]) for k in ("lat", "lon", "height")]
    error = small_site.frame.enu_from_lla(*lla) - [small_site.cameras[row["image"]].centre for row in rows]
    # The reference is off by a known bias, and so must the result be. 70 m above ground a degree of tilt is 1.2 m, and
    # a percent of focal length 0.7 m of height; these few photos leave it uncertain by nearly two.
    assert np.abs(small_site.bias_m).min() > 1.2
    assert (np.abs(error.mean(axis=0) - small_site.bias_m) < [0.3, 0.3, 0.6]).all()
    relative = np.linalg.norm(error - error.mean(axis=0), axis=1)
    assert 0.001 < relative.mean() < 0.005 * STANDOFF_M
    assert relative.max() < 0.01 * STANDOFF_M
    enu = np.array([[float(row[k]) for k in ("east", "north", "up")] for row in rows])
    offsets = enu - small_site.frame.enu_from_lla(*lla)
    assert np.ptp(offsets, axis=0).max() < 0.01  # the run has an origin of its own, with parallel axes here


def test_summary_says_how_well(finished: Path, small_site: Site) -> None:
    summary = summary_of(finished)
    (found,) = summary["sets"]
    (component,) = found["components"]
    assert found["status"] == component["status"] == "REGISTERED"
    assert component["n_cameras"] == OPTIONS.airborne
    assert component["n_inliers"] > 1000 and component["inlier_ratio"] > 0.8
    assert 0.02 < component["rmse_m"] < 0.4
    assert component["tilt_deg"] < 1.0
    assert component["enu_from_sfm"]["scale"] > 0
    assert summary["seed"] == 3 and summary["options"]["match"]["max_height_m"] == 85
    # Of the reference alone; registration and focal length add to it.
    ce90, le90 = ACCURACY_M[OPTIONS.preset]
    assert ce90 - 0.01 < component["predicted_ce90_m"] < ce90 + 0.3
    assert le90 < component["predicted_le90_m"] < le90 + 1.5
    assert all(stage["seconds"] >= 0 and stage["peak_mib"] > 0 for stage in summary["stages"])
    assert component["diagnostics"]["false_alarm_probability"] < 0.005


def test_other_places_are_told_beside_the_believed_one(finished: Path) -> None:
    summary = summary_of(finished)
    (component,) = summary["sets"][0]["components"]
    best, *others = component["hypotheses"]
    assert others and all(best["score"] > 1.3 * other["score"] for other in others)
    # The level frame's unit is the cameras' height above ground.
    unit_m = component["enu_from_sfm"]["scale"] * component["gravity"]["camera_height"]
    assert best["metres_per_unit"] == pytest.approx(unit_m, rel=0.03)
    centre = component["scene_centre_enu"]
    assert np.hypot(best["east"] - centre[0], best["north"] - centre[1]) < 15
    origin = component["enu_origin"]
    frame = EnuFrame(origin["lat"], origin["lon"], origin["height"])
    enu = frame.enu_from_lla(best["lat"], best["lon"], origin["height"])[0]
    np.testing.assert_allclose(enu[:2], [best["east"], best["north"]], atol=0.01)


def test_evaluation(copied: Path, small_site: Site) -> None:
    assert main(["evaluate", str(copied), "--truth", str(small_site.folder / "truth.csv")]) == 0
    (row,) = json.loads((copied / "evaluation.json").read_text())["rows"]
    assert row["n_cameras"] == OPTIONS.airborne and row["status"] == "REGISTERED"
    assert row["mean_absolute_m"] == pytest.approx(np.linalg.norm(small_site.bias_m), abs=0.4)
    assert row["mean_relative_m"] < 0.005 * row["standoff_m"]
    assert row["standoff_m"] == pytest.approx(STANDOFF_M, abs=4)
    # The registration's own uncertainty makes the same error a little less surprising.
    surprise = float(mahalanobis(small_site.bias_m, small_site.covariance)[0])
    assert surprise > 2 and 0.8 < row["mahalanobis_of_mean"] / surprise < 1.05


def test_products_lie_on_the_reference(finished: Path, small_site: Site) -> None:
    with rasterio.open(finished / "dsm.tif") as mine, rasterio.open(small_site.folder / "reference/dsm.tif") as theirs:
        assert mine.crs == theirs.crs
        place = mine.transform
        heights, known = mine.read(1), mine.read_masks(1) > 0
        rows, columns = (index[::7] for index in np.nonzero(known))
        x, y = place.c + (columns + 0.5) * place.a, place.f + (rows + 0.5) * place.e
        reference = np.array([value[0] for value in theirs.sample(np.column_stack([x, y]))])
        assert place.a < 0.8 * theirs.transform.a  # as fine as the photos, not as the reference
    with rasterio.open(finished / "confidence.tif") as trust:
        confidence = trust.read(1)
    assert 0.3 < known.mean() < 0.98  # the bounds are those of the flight
    assert ((confidence == 255) == ~known).all()
    sure = (reference > -9000) & (confidence[rows, columns] > 30)
    difference = (heights[rows, columns] - reference)[sure]
    assert len(difference) > 1000
    assert abs(np.median(difference)) < 0.15
    assert 0.02 < np.median(np.abs(difference)) < 0.3
    with rasterio.open(finished / "ortho.tif") as ortho:
        assert ortho.crs == theirs.crs and ortho.count >= 3
    assert (finished / "pointcloud.laz").stat().st_size > 10_000
    assert (finished / "colmap/airborne_0/georeference.json").exists()


def test_a_second_run_is_served_from_the_cache(copied: Path, small_site: Site) -> None:
    before = (copied / "cameras.csv").read_text()
    assert run(small_site.folder / "airborne.toml", copied) == 0
    assert computed_stages(copied) == set()
    assert (copied / "cameras.csv").read_text() == before


def test_a_radiance_field_places_the_photos_as_well(
    copied: Path, small_site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A small field, for time only: depth maps tell it nearly everything.
    sizes = Sizes(levels=4, table_log2=15, finest_table_log2=17, hidden=16, colour_hidden=16, rays=1024, iterations=10)
    monkeypatch.setattr(NerfOptions, "sizes", sizes)
    options = ("--set", "model.kind=nerf")
    mesh = rows_of(copied / "cameras.csv")
    assert run(small_site.folder / "airborne.toml", copied, *options) == 0
    redone = ("model", "nadir", "search", "decoys", "places", "register")
    assert computed_stages(copied) == {f"airborne-0.{stage}" for stage in redone}
    apart = [
        np.linalg.norm([float(a[key]) - float(b[key]) for key in ("east", "north", "up")])
        for a, b in zip(mesh, rows_of(copied / "cameras.csv"), strict=True)
    ]
    assert 1e-4 < np.mean(apart) < 0.6
    assert not list((copied / "stages").glob("*.unfinished"))


def test_too_few_ground_photos_are_refused_and_listed(copied: Path, small_site: Site) -> None:
    before = rows_of(copied / "cameras.csv")
    fewer = ("finalists=4", "matched=1", "searched_walls=3")
    assert run(small_site.toml, copied, *(word for one in fewer for word in ("--set", f"ground.walls.{one}"))) == 3
    # The airborne photos are where they were.
    assert all(stage == "walls" or stage.startswith("ground0") for stage in computed_stages(copied))
    airborne, ground = summary_of(copied)["sets"]
    assert airborne["status"] == "REGISTERED"
    assert ground["status"] == "NOT_REGISTERED" and ground["n_images"] == OPTIONS.group_photos
    assert ground["reason"] or all(component["reason"] for component in ground["components"])
    rows = rows_of(copied / "cameras.csv")
    added = [row for row in rows if row["image"].startswith("ground/")]
    assert [row for row in rows if row not in added] == before
    assert sorted(row["image"] for row in added) == [f"ground/a_{k:03d}.jpg" for k in range(OPTIONS.group_photos)]
    for row in added:
        assert row["status"] == "NOT_REGISTERED" and not any(row[key] for key in PLACE)


def test_a_changed_option_redoes_only_what_depends_on_it(copied: Path, small_site: Site) -> None:
    assert run(small_site.folder / "airborne.toml", copied, "--set", "register.min_score=500") == 3
    assert computed_stages(copied) == {"airborne-0.register"}
    (component,) = summary_of(copied)["sets"][0]["components"]
    assert component["status"] == "NOT_REGISTERED" and "500" in component["reason"]


def test_a_decoy_reference_is_refused(
    copied: Path, small_site: Site, small_world: SmallWorld, tmp_path: Path, rng: np.random.Generator
) -> None:
    (copied / "evaluation.json").write_text("{}")
    # Off by more than its width, it shows the next quarter.
    decoy = make_reference(small_world, small_world.scene(dates_of(OPTIONS).satellite), np.array([170.0, 0, 0]), rng)
    decoy.write_ortho(tmp_path / "ortho.tif")
    decoy.write_dsm(tmp_path / "dsm.tif")
    photos = small_site.folder / "airborne"
    arguments = ["run", "--airborne", str(photos), "--out", str(copied), "--seed", "3", "--quiet"]
    arguments += ["--ortho", str(tmp_path / "ortho.tif"), "--dsm", str(tmp_path / "dsm.tif")]
    arguments += ["--vertical-datum", "ellipsoid", "--ce90", "2.5", "--le90", "3.8", *FASTER]
    assert main(arguments) == 3
    summary = summary_of(copied)
    (component,) = summary["sets"][0]["components"]
    assert summary["sets"][0]["status"] == component["status"] == "NOT_REGISTERED"
    assert component["reason"] and "enu_from_sfm" not in component
    rows = rows_of(copied / "cameras.csv")
    assert len(rows) == OPTIONS.airborne
    for row in rows:
        assert row["status"] == "NOT_REGISTERED" and not any(row[key] for key in PLACE)
    # Nothing of the run before may be left that looks like a result.
    for name in ("pointcloud.laz", "ortho.tif", "dsm.tif", "evaluation.json"):
        assert not (copied / name).exists(), name
    assert "reconstruct" not in computed_stages(copied)
