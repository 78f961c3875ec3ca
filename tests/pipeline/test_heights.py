# SPDX-License-Identifier: Apache-2.0
"""The place stays where it is, whatever the elevation model; wrong heights are named, and none is written."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from skymoor.cli.main import main
from skymoor.simulate.site import Site
from support.small_run import FASTER, SEED, rows_of, summary_of

pytestmark = pytest.mark.e2e

Array = NDArray[np.float64]


def run_with(small_site: Site, out: Path, dsm: Path | None, *more: str) -> int:
    """The exit status of the finished run's photos on its orthophoto with another elevation model, or none."""
    folder = small_site.folder
    arguments = ["run", "--airborne", str(folder / "airborne"), "--ortho", str(folder / "reference/ortho.tif")]
    arguments += ["--ce90", "2.5", "--out", str(out), "--seed", str(SEED), "--quiet", *FASTER, *more]
    if dsm is not None:
        arguments += ["--dsm", str(dsm), "--vertical-datum", "ellipsoid", "--le90", "3.8"]
    return main(arguments)


def plan_errors(out: Path, small_site: Site) -> Array:
    """Errors (n, 2) in metres, east and north, beside the reference's own bias."""
    rows = rows_of(out / "cameras.csv")
    true = np.array([small_site.cameras[row["image"]].centre for row in rows])
    heights = small_site.frame.lla_from_enu(true)[:, 2]
    lat, lon = (np.array([float(row[name]) for row in rows]) for name in ("lat", "lon"))
    found = small_site.frame.enu_from_lla(lat, lon, heights)
    return np.asarray((found - true - small_site.bias_m)[:, :2])


def test_heights_in_feet_are_named_and_not_written(finished: Path, small_site: Site, tmp_path: Path) -> None:
    out = Path(shutil.copytree(finished, tmp_path / "out"))
    feet = tmp_path / "feet.tif"
    with rasterio.open(small_site.folder / "reference/dsm.tif") as source:
        heights, profile = source.read(1), source.profile
    with rasterio.open(feet, "w", **profile) as target:
        target.write(np.where(heights == profile["nodata"], heights, heights / np.float32(0.3048)), 1)
    assert run_with(small_site, out, feet) == 0
    (component,) = summary_of(out)["sets"][0]["components"]
    assert component["status"] == "REGISTERED" and component["heights"] == "NOT_CONFIRMED"
    assert 3.0 < component["height_scale"] < 3.5 and "feet" in component["height_verdict"]["reason"]
    assert component["predicted_le90_m"] is None
    for row in rows_of(out / "cameras.csv"):
        assert (row["height"], row["le90"], row["heights"]) == ("", "", "NOT_CONFIRMED")
    within = np.linalg.norm(plan_errors(out, small_site), axis=1)
    assert 0.001 < within.mean() < 1.5
    # What needs heights is there, and says that they are relative.
    assert "NOT_CONFIRMED" in (out / "colmap/airborne_0/georeference.json").read_text()
    assert "feet" in (out / "report.html").read_text()


def test_without_an_elevation_model_the_place_is_found(finished: Path, small_site: Site, tmp_path: Path) -> None:
    out = Path(shutil.copytree(finished, tmp_path / "out"))
    assert run_with(small_site, out, None, "--require-heights") == 3
    (component,) = summary_of(out)["sets"][0]["components"]
    assert component["status"] == "REGISTERED" and component["heights"] == "NOT_CONFIRMED"
    within = np.linalg.norm(plan_errors(out, small_site), axis=1)
    relative = np.array([float(row["relative_ce90"]) for row in rows_of(out / "cameras.csv")])
    assert 0.001 < within.mean() < 2.0
    # Nothing but the levelling says where up is, and CE90 holds that.
    assert np.mean(within <= relative) > 0.7
    up = np.array([float(row["up"]) for row in rows_of(out / "cameras.csv")])
    assert (up > 40).all() and (up < 95).all()
