# SPDX-License-Identifier: Apache-2.0
"""The products of an earlier run as a reference."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skymoor
from skymoor.errors import InputError
from skymoor.geo import ce90_m, le90_m
from skymoor.pipeline.option_parser import parse_option
from skymoor.pipeline.reference_files import earlier_run
from skymoor.pipeline.site import load_site, site_on_run
from skymoor.simulate.site import Site
from support.finished import finished_run
from support.small_run import FASTER, SEED

TOTAL = np.diag([1.2, 1.3, 2.5])
SURFACE = {"covariance_m2": TOTAL.tolist(), "relative_covariance_m2": np.diag([0.2, 0.3, 0.5]).tolist()}


def told(run: Path, change: Any) -> Path:
    """A finished run whose summary was changed."""
    file = run / "summary.json"
    summary = json.loads(file.read_text())
    change(summary, summary["sets"][0]["components"][0])
    file.write_text(json.dumps(summary))
    return run


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return told(finished_run(tmp_path), lambda summary, part: part.update(surface_accuracy=SURFACE))


def test_the_accuracy_is_that_of_the_earlier_surface(run: Path) -> None:
    files = earlier_run(run)
    np.testing.assert_array_equal(files.covariance, TOTAL)
    assert files.rasters == (run / "ortho.tif", run / "dsm.tif", "ellipsoid") and files.run == run


def test_the_least_accurate_component_counts(run: Path) -> None:
    def worse(summary: dict[str, Any], part: dict[str, Any]) -> None:
        second = part | {"component": 1, "surface_accuracy": {"covariance_m2": (4 * TOTAL).tolist()}}
        summary["sets"][0]["components"].append(second)

    np.testing.assert_array_equal(earlier_run(told(run, worse)).covariance, 4 * TOTAL)


def test_unknown_accuracy_and_unconfirmed_heights_stay_so(run: Path) -> None:
    def unknown(summary: dict[str, Any], part: dict[str, Any]) -> None:
        summary["reference"]["covariance_m2"] = None
        part["heights"] = "NOT_CONFIRMED"

    files = earlier_run(told(run, unknown))
    assert np.isnan(files.covariance).all() and files.dsm is None


def test_what_cannot_be_a_reference(run: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere/summary.json: no summary of a finished run"):
        earlier_run(tmp_path / "nowhere")
    (run / "dsm.tif").unlink()
    with pytest.raises(InputError, match=r"dsm.tif: the run has no such product, so it cannot be a reference"):
        earlier_run(run)


def test_a_run_of_a_former_version(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not say how accurate its surface is; give the command of that run aga"):
        earlier_run(finished_run(tmp_path, former=True))


def test_a_site_on_an_earlier_run(run: Path, tmp_path: Path) -> None:
    toml = tmp_path / "site.toml"
    toml.write_text('[reference]\nrun = "run"\n[airborne]\nimages = "air"\n')
    assert load_site(toml).reference.ortho == run / "ortho.tif"
    assert site_on_run([tmp_path / "air"], [], run).reference.run == run
    toml.write_text('[reference]\nrun = "run"\nce90 = 2.0\northo = "ortho.tif"\n[airborne]\nimages = "air"\n')
    with pytest.raises(InputError, match=r"reference.run says what ce90 and ortho would; keep one of them"):
        load_site(toml)
    with pytest.raises(InputError, match=r"--reference-run .*/run already names the reference: leave out --le90"):
        skymoor.register(airborne=tmp_path / "air", reference_run=run, le90=3.0, out=tmp_path / "out")


@pytest.mark.e2e
def test_the_same_flight_on_its_own_run(finished: Path, small_site: Site, tmp_path: Path) -> None:
    """It comes back to where it was; its accuracy is that of the earlier run and of this registration together."""
    out = shutil.copytree(finished, tmp_path / "out")  # only what depends on the reference is done again
    options = dict(map(parse_option, FASTER[1::2]))
    airborne = small_site.folder / "airborne"
    found = skymoor.register(airborne=airborne, reference_run=finished, out=out, options=options, seed=SEED)
    before = skymoor.read(finished)
    assert found.registered and found.heights_confirmed
    was = {Path(row.image).name: row for row in before.registered_cameras}
    lla = np.array([[one.lat, one.lon, one.height] for one in found.registered_cameras], dtype=np.float64)
    now = before.frame.enu_from_lla(*lla.T)
    then = [[one.east, one.north, one.up] for one in (was[Path(row.image).name] for row in found.registered_cameras)]
    errors = now - np.array(then, dtype=np.float64)
    assert np.abs(errors).max() < 1.0  # itself, matched with itself
    earlier = before.components[0].summary["surface_accuracy"]
    later = found.components[0].summary["surface_accuracy"]
    total = np.array(earlier["covariance_m2"]) + np.array(later["relative_covariance_m2"])
    assert later["ce90_m"] == pytest.approx(ce90_m(total), rel=0.01)
    assert later["le90_m"] == pytest.approx(le90_m(total), rel=0.01)
    assert later["relative_ce90_m"] < later["ce90_m"]
    changes = json.loads((out / "changes.geojson").read_text())
    assert not changes["features"] and 0 < changes["limit_m"] < 2.0
    assert "Changes since the earlier run" in (out / "report.html").read_text()
