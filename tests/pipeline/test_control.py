# SPDX-License-Identifier: Apache-2.0
"""Components on control: where they lie afterwards, how accurate they say to be, and what stays as it is."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skymoor.control import Control
from skymoor.errors import InputError
from skymoor.geo import UNKNOWN_ACCURACY, Grid
from skymoor.geometry import Similarity, moved_similarity
from skymoor.pipeline.control import control_of, with_control
from skymoor.pipeline.control_places import Stated
from skymoor.pipeline.job import ComponentResult, Job
from skymoor.pipeline.options import Options
from skymoor.pipeline.site_control import ControlFiles
from skymoor.registration import camera_accuracy
from skymoor.results.accuracy import accuracy_of, figures_of
from skymoor.simulate.site import Site
from skymoor.store import Store
from skymoor.types import (
    Array,
    Calibration,
    HeightVerdict,
    Photos,
    Progress,
    Reference,
    Registration,
    Render,
    View,
    no_progress,
)
from support.blocks import ground_points, observed
from support.small_run import rows_of, run, summary_of
from support.surveyed import CENTRE, FRAME, SIGMAS, SIX, flown, place, surveyed

ERROR = np.array([0.003, 0.001, -0.001, 0.002, 0.8, -0.6, 1.5])
REFERENCE_M2 = np.diag([0.6, 0.6, 2.2])
REFERENCE = Reference(
    FRAME,
    Grid(-60.0, 60.0, 1.0, (120, 120)),
    np.zeros((120, 120, 3), np.uint8),
    np.ones((120, 120), bool),
    np.zeros((120, 120), np.float32),
    REFERENCE_M2,
    0.5,
)
RELATIVE = np.diag(np.append(SIGMAS[:4], [0.1, 0.1, 0.1]) ** 2)
NOTHING = np.zeros((1, 1), np.float32)
SURE = Calibration(
    shared_intrinsics=True,
    focal_px=392.0,
    focal_sigma_ratio=1e-4,
    focal_low_ratio=0.9998,
    focal_high_ratio=1.0002,
    uncertain=False,
)


def airborne(heights: HeightVerdict | None = None) -> ComponentResult:
    """A component whose registration must be corrected by `ERROR`."""
    component = replace(observed(flown(), ground_points(200, relief_m=4.0)), calibration=SURE)
    wrong = moved_similarity(Similarity.identity(), ERROR, CENTRE).inverse()
    found = Registration(
        True, "", wrong, covariance=RELATIVE, centroid_enu=CENTRE, heights=heights, tilt_deg=0.0, n_matches=100
    )
    return ComponentResult("airborne-0", component, Similarity.identity(), found)


def job_of(folder: Path, reference: Reference = REFERENCE) -> Job:
    names = tuple(camera.image for camera in flown())
    photos = Photos(names, tuple((400, 300) for _ in names), lambda _: np.zeros((1, 1, 3), np.uint8))

    def track(_: str) -> Progress:
        return no_progress

    with Store.open(folder) as store:
        return Job(photos, reference, Options(), store, 0, track)


def one(item: ComponentResult, control: Control, job: Job) -> ComponentResult:
    (found,) = with_control([item], control, job)
    return found


def errors(item: ComponentResult) -> Array:
    true = {camera.image: camera.centre for camera in flown()}
    return np.array([camera.centre - true[camera.image] for camera in item.cameras_enu])


def test_a_check_moves_nothing(tmp_path: Path) -> None:
    item, job = airborne(), job_of(tmp_path)
    found = one(item, surveyed(), job)
    assert found.registration is item.registration and found.control is not None and not found.control.used
    assert {row.use for row in found.control.rows} == {"check"} and found.control.totals.inside_ce90 == 1.0
    assert one(item, Control(), job).control is None


def test_control_moves_cameras_and_their_accuracy(rng: np.random.Generator, tmp_path: Path) -> None:
    item = airborne()
    found = one(item, surveyed(rng=rng, use=True), job_of(tmp_path))
    before, after = errors(item), errors(found)
    assert np.linalg.norm(before, axis=1).min() > 1.2 and np.linalg.norm(after, axis=1).max() < 0.3
    accuracy = accuracy_of(found, REFERENCE)
    assert not accuracy.shared.any()
    distance = np.sqrt(np.einsum("ni,nij,nj->n", after, np.linalg.inv(accuracy.total), after))
    assert 0.2 < np.median(distance) < 3.5
    ce90, le90, relative_ce90, _ = figures_of(accuracy).mean(axis=0)
    assert 0.03 < ce90 < 0.4 and relative_ce90 == ce90 and 0.03 < le90 < 0.5
    assert figures_of(accuracy_of(item, REFERENCE))[:, 0].min() > 1.5
    # Of a point straight below, without the focal length.
    ground = camera_accuracy(found.registration, SIX[:1], REFERENCE, None).total[0]
    assert 0.01 < np.sqrt(ground[0, 0]) < 0.1


def test_a_reference_of_unknown_accuracy_does_not_matter_to_control(rng: np.random.Generator, tmp_path: Path) -> None:
    unknown = replace(REFERENCE, covariance=UNKNOWN_ACCURACY)
    found = one(airborne(), surveyed(rng=rng, use=True), job_of(tmp_path, unknown))
    assert np.isfinite(figures_of(accuracy_of(found, unknown))).all()
    assert np.linalg.norm(errors(found), axis=1).max() < 0.3


def test_heights_that_nobody_confirmed_hang_on_control(rng: np.random.Generator, tmp_path: Path) -> None:
    lost = HeightVerdict("NOT_CONFIRMED", "the reference has no heights here")
    found = one(airborne(lost), surveyed(rng=rng, use=True), job_of(tmp_path))
    assert found.heights is not None and found.heights.status == "OFFSET_ONLY"
    assert found.heights.reason == "heights hang on control; without it: the reference has no heights here"
    assert np.abs(errors(found)[:, 2]).max() < 0.3
    checked = one(airborne(lost), surveyed(rng=rng), job_of(tmp_path))
    assert checked.heights is lost


def test_what_stands_on_a_moved_component_is_as_sure_as_that(rng: np.random.Generator, tmp_path: Path) -> None:
    job = job_of(tmp_path)
    base = one(airborne(), surveyed(rng=rng, use=True), job)
    own = Registration(True, "", Similarity.identity(), covariance=RELATIVE / 100, centroid_enu=CENTRE)
    ground = replace(airborne(), name="ground0-0", registration=own, base=base)
    assert figures_of(accuracy_of(ground, REFERENCE))[:, 0].max() < 0.5
    on_map = replace(ground, base=airborne())
    assert figures_of(accuracy_of(on_map, REFERENCE))[:, 0].min() > 1.5
    # It is compared with control, and moves with its base alone.
    found = one(ground, surveyed(rng=rng, use=True), job)
    assert found.control is not None and not found.control.used and found.registration is own


def test_a_component_that_cannot_be_compared_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job, item = job_of(tmp_path), airborne()
    refused = replace(item, registration=Registration(False, "no", None))
    assert one(refused, surveyed(), job) is refused

    def fails(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("skymoor.pipeline.control.examine", fails)
    assert one(item, surveyed(), job) is item


def test_control_far_from_the_site_is_wrong_input(tmp_path: Path) -> None:
    job, control = job_of(tmp_path), surveyed()
    files = ControlFiles((), Stated(), given=control)
    assert control_of(files, [job]) == (control, [])
    assert control_of(None, [job]) == (None, [])
    exchanged = replace(place(SIX[0]), lat=8.0, lon=47.0)
    points = (replace(control.points[0], place=exchanged), *control.points[1:])
    with pytest.raises(
        InputError, match=r"gcp.txt, line 2: P0 lies at latitude 8.0.* km from the reference; is the CRS"
    ):
        control_of(replace(files, given=replace(control, points=points)), [job])


@pytest.mark.e2e
def test_known_positions_of_some_photos(finished: Path, small_site: Site, tmp_path: Path) -> None:
    """The reference is off by meters; four photos whose true positions are known take that out of all 16."""
    truth = {row["image"]: row for row in rows_of(small_site.folder / "truth.csv")}
    known = [image for image in truth if image.startswith("airborne/")][::4]
    lines = [",".join([image, *(truth[image][key] for key in ("lat", "lon", "height"))]) for image in known]
    file = tmp_path / "rtk.csv"
    file.write_text("\n".join(["image,lat,lon,height", *lines]) + "\n")
    out = shutil.copytree(finished, tmp_path / "out")
    stated = ["--control", str(file), "--control-ce90", "0.03", "--control-le90", "0.05"]
    stated += ["--control-datum", "ellipsoid"]
    assert run(small_site.folder / "airborne.toml", out, *stated) == 0
    (checked,) = summary_of(out)["sets"][0]["components"]
    assert checked["control"]["totals"]["n"] == 4 and not checked["control"]["used"]
    assert checked["control"]["totals"]["inside_ce90"] >= 0.75
    assert rows_of(out / "cameras.csv") == rows_of(finished / "cameras.csv")
    rows = rows_of(out / "control.csv")
    assert [row["name"] for row in rows] == known and {row["use"] for row in rows} == {"check"}
    assert "Control and check points" in (out / "report.html").read_text(encoding="utf-8")

    assert run(small_site.folder / "airborne.toml", out, *stated, "--use-control") == 0
    (used,) = summary_of(out)["sets"][0]["components"]
    assert used["control"]["used"] and used["predicted_ce90_m"] < 0.5 * checked["predicted_ce90_m"]
    others = [row for row in rows_of(out / "cameras.csv") if row["image"] not in known]
    before = {row["image"]: row for row in rows_of(finished / "cameras.csv")}

    def far(rows: list[dict[str, str]]) -> float:
        """Mean horizontal error in metres."""
        gaps = [[float(row[key]) - float(truth[row["image"]][key]) for key in ("lat", "lon")] for row in rows]
        lat = np.radians(float(rows[0]["lat"]))
        return float(np.linalg.norm(np.array(gaps) * 111_320.0 * [1.0, np.cos(lat)], axis=1).mean())

    assert far(others) < 0.5 * far([before[row["image"]] for row in others])
    assert run(small_site.folder / "airborne.toml", out) == 0
    assert not (out / "control.csv").exists() and rows_of(out / "cameras.csv") == rows_of(finished / "cameras.csv")


def lost() -> ComponentResult:
    """A component in a frame of its own that was not found on the map."""
    turn = Similarity.from_quaternion_wxyz(0.02, np.array([0.9, 0.1, -0.2, 0.4]), np.array([1.0, 2.0, 3.0]))
    item = airborne()
    render = Render(View(np.eye(3), 0.0, 0.0, 1.0, (1, 1)), np.zeros((1, 1, 3), np.uint8), NOTHING[..., None], NOTHING)
    refused = Registration(False, "match score 3 is below the minimum of 36", None)
    return replace(item, component=replace(item.component.transformed(turn)), registration=refused, render=render)


def test_a_component_that_was_not_found_is_placed_by_control(rng: np.random.Generator, tmp_path: Path) -> None:
    job, item = job_of(tmp_path), lost()
    found = one(item, surveyed(rng=rng, use=True, off={3: np.array([0.0, 3.0, 0.0])}), job)
    assert found.registration.registered and found.control is not None and found.control.used
    assert [row.name for row in found.control.rows if row.use == "wrong"] == ["P3"]
    (asked,) = found.registration.criteria
    assert (asked.kind, asked.value, asked.limit) == ("control_points", 5.0, 4.0)
    gaps = np.linalg.norm(errors(found), axis=1)
    assert 0.001 < gaps.max() < 0.6 and found.heights is not None and found.heights.status == "OFFSET_ONLY"
    total = accuracy_of(found, REFERENCE).total
    distance = np.sqrt(np.einsum("ni,nij,nj->n", errors(found), np.linalg.inv(total), errors(found)))
    assert 0.2 < np.median(distance) < 3.5
    assert found.control.totals.n == 0 and "placed by control alone" in found.control.notes[0]


def test_too_little_control_places_nothing(rng: np.random.Generator, tmp_path: Path) -> None:
    job, item = job_of(tmp_path), lost()
    assert one(item, surveyed(rng=rng), job) is item  # which is to be compared only
    for control, words in (
        (surveyed(SIX[:3], rng=rng, use=True), "3 surveyed positions with heights in it, at least 4 are needed"),
        (
            surveyed(SIX[:4], rng=rng, use=True, off={1: np.array([5.0, 0, 0])}),
            "3 surveyed positions in it agree, at least 4",
        ),
        (surveyed(np.outer(np.arange(4.0), [9.0, 4.0, 0.5]), use=True), "lie on one line"),
        (surveyed(np.outer(np.arange(4.0), [9.0, 4.0, 0.5]), rng=rng, use=True), "lie nearly on one line"),
    ):
        found = one(item, control, job)
        assert not found.registration.registered and found.control is not None
        assert "control alone does not place it" in found.control.reason and words in found.control.reason
