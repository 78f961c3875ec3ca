# SPDX-License-Identifier: Apache-2.0
"""What a ground component that stands on an airborne one leaves in the tables."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from skymoor.geo import EnuFrame, Grid
from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.geometry import Similarity
from skymoor.ground.walls import GroundPoseCheck
from skymoor.pipeline.job import ComponentResult
from skymoor.pipeline.options import Options
from skymoor.pipeline.reference_files import ReferenceFiles
from skymoor.pipeline.site import Site
from skymoor.results.accuracy import accuracy_of, figures_of, surface_accuracy
from skymoor.results.read import Result
from skymoor.results.write import SetResult, camera_rows, write_products
from skymoor.store import PRODUCTS, Store
from skymoor.types import Calibration, Reference, Registration
from support.blocks import block

COVARIANCE = np.diag([0.5, 0.6, 2.0])
REFERENCE = Reference(
    EnuFrame(47.0, 8.0, 400.0),
    Grid(-20.0, 20.0, 1.0, (40, 40)),
    np.zeros((40, 40, 3), np.uint8),
    np.ones((40, 40), bool),
    np.zeros((40, 40), np.float32),
    COVARIANCE,
    0.5,
)


def registration(variance_m2: float, centre: list[float]) -> Registration:
    covariance = np.diag([1e-8] * 4 + [variance_m2] * 3)
    return Registration(
        True, "", Similarity.identity(), covariance=covariance, centroid_enu=np.array(centre), n_matches=100
    )


@pytest.fixture
def ground() -> ComponentResult:
    component = replace(block("orbit", relief_m=5.0), calibration=None)
    base = ComponentResult("airborne-0", component, Similarity.identity(), registration(0.3, [0, 0, 0]))
    return ComponentResult("ground0-0", component, Similarity.identity(), registration(0.2, [0, 0, 0]), base=base)


def check(image: str, *, contradicts: bool) -> GroundPoseCheck:
    return GroundPoseCheck(image, 0.5, 0.5, 100, 1.2 if contradicts else 0.1, True, contradicts)


def test_a_ground_camera_is_as_unsure_as_all_that_it_stands_on(ground: ComponentResult) -> None:
    alone = figures_of(accuracy_of(replace(ground, base=None), REFERENCE))
    both = figures_of(accuracy_of(ground, REFERENCE))
    # Horizontal variances of about 0.55 + 0.2, and with the airborne model's 0.3 on top.
    assert np.median(both[:, 0] / alone[:, 0]) == pytest.approx(np.sqrt((0.55 + 0.5) / (0.55 + 0.2)), rel=0.02)
    assert np.median(both[:, 1]) == pytest.approx(1.6449 * np.sqrt(2.0 + 0.5), rel=0.05)
    # The same without the reference's error.
    assert np.median(both[:, 2] / alone[:, 2]) == pytest.approx(np.sqrt(0.5 / 0.2), rel=0.02)
    assert np.median(both[:, 3]) == pytest.approx(1.6449 * np.sqrt(0.5), rel=0.05)


def test_the_summary_holds_what_the_report_says(ground: ComponentResult, tmp_path: Path) -> None:
    item = replace(ground, base=None)
    images = [camera.image for camera in item.component.cameras]
    site = Site("s", tmp_path, ReferenceFiles(tmp_path / "ortho.tif", 3.0, "EPSG:3855", COVARIANCE), (tmp_path,), ())
    with Store.open(tmp_path / "out") as store:
        write_products([SetResult("airborne", (tmp_path,), images, [item])], site, REFERENCE, Options(), 0, {}, store)
    result = Result.read(tmp_path / "out")
    assert datetime.fromisoformat(result.summary["date"]).tzinfo is not None
    assert result.summary["coordinate_systems"]["reference_heights"]["epsg"] == 3855
    figures, details = result.components[0].summary["statistics"], result.statistics["airborne_0"]
    assert [row["image"] for row in details["photos"]] == images
    assert sum(row["n_points"] for row in details["photos"]) == figures["n_observations"] == len(item.component.obs_px)
    assert figures["lenses"][0]["sigma"]["k1"] > 0 and len(details["residuals"]) == 1
    for row, camera in zip(details["photos"], result.cameras, strict=True):
        major, minor, _ = row["ellipse_90"]
        assert camera.ce90 is not None and 0.75 * major < camera.ce90 <= 1.01 * major and 0 < minor <= major
    written = [path.name for path in (tmp_path / "out").iterdir()]
    assert not set(written) - set(PRODUCTS) - {".lock"}  # what is not known as a product would not be protected
    assert (tmp_path / "out" / "summary.json").stat().st_size < 40_000


def test_a_camera_that_contradicts_gets_no_place(ground: ComponentResult) -> None:
    images = [camera.image for camera in ground.component.cameras]
    doubted = replace(ground, pose_checks=[check(image, contradicts=image == images[1]) for image in images])
    rows = camera_rows(SetResult("ground0", Path("ground"), [*images, "ground/alone.jpg"], [doubted]), REFERENCE)
    assert sorted(row.image for row in rows) == sorted([*images, "ground/alone.jpg"])
    unplaced = {row.image: row for row in rows if row.lat is None}
    assert set(unplaced) == {images[1], "ground/alone.jpg"}
    assert unplaced[images[1]].component == 0 and unplaced["ground/alone.jpg"].component is None
    assert all(row.status == "REGISTERED" for row in rows if row.image not in unplaced)


def test_what_a_doubted_camera_sees_leaves_the_model(ground: ComponentResult) -> None:
    images = [camera.image for camera in ground.component.cameras]
    turn = Similarity.from_quaternion_wxyz(2.0, [0.9, 0.1, 0.3, -0.2], [5.0, 6.0, 7.0])
    doubted = replace(
        ground,
        pose_checks=[check(image, contradicts=image == images[1]) for image in images],
        registration=replace(ground.registration, enu_from_level=turn),
    )
    whole, left = ground.component.transformed(turn), doubted.component_enu
    assert left is not None
    assert [camera.image for camera in left.cameras] == [image for image in images if image != images[1]]
    np.testing.assert_allclose(left.centres, np.delete(whole.centres, 1, axis=0), atol=1e-9)
    kept = whole.obs_camera != 1
    np.testing.assert_array_equal(left.obs_px, whole.obs_px[kept])
    np.testing.assert_array_equal(left.obs_camera, whole.obs_camera[kept] - (whole.obs_camera[kept] > 1))
    np.testing.assert_array_equal(left.points, whole.points)
    assert replace(doubted, registration=replace(ground.registration, registered=False)).component_enu is None


def test_a_focal_length_moves_cameras_along_their_view() -> None:
    """One percent of the distance to what is shown: down for a nadir camera, and also aside for an oblique one."""
    calibration = Calibration(True, 500.0, 0.0, 0.99, 1.01, False)
    component = replace(block("orbit", relief_m=2.0), calibration=calibration)
    base = ComponentResult("airborne-0", component, Similarity.identity(), registration(1e-12, [0, 0, 0]))
    found = accuracy_of(base, REFERENCE).relative
    for camera, covariance in zip(base.cameras_enu, found, strict=True):
        distance = np.sqrt(covariance.trace()) / (0.01 / LE90_PER_SIGMA)
        assert 0.7 < distance / np.linalg.norm(camera.centre - np.median(component.points, axis=0)) < 1.3
        axis = camera.cam_from_world.rotation[2]
        assert axis @ covariance @ axis > 0.8 * covariance.trace()


def test_a_surface_is_never_surer_than_what_all_matches_share(ground: ComponentResult) -> None:
    assert ground.base is not None
    sure = replace(ground.base, registration=registration(1e-8, [0, 0, 0]))
    found = surface_accuracy(sure, REFERENCE)
    assert found is not None
    assert found["relative_ce90_m"] == pytest.approx(2.146 * 0.15 * REFERENCE.grid.pixel_m, rel=0.05)
    assert found["relative_le90_m"] == pytest.approx(LE90_PER_SIGMA * 0.1, rel=0.05)
    assert surface_accuracy(ground, REFERENCE) is None
