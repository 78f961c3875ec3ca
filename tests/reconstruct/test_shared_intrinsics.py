# SPDX-License-Identifier: Apache-2.0
"""Lenses that are shared must be found, others be left alone, and those that nothing fixes be given up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

from skymoor.engines.colmap import colmap_from_component
from skymoor.geometry import umeyama
from skymoor.reconstruct import IntrinsicsOptions
from skymoor.reconstruct.calibration import adjust, calibrate
from skymoor.reconstruct.mapping import _adjusted
from skymoor.reconstruct.shared_intrinsics import (
    _regrouped,
    group_intrinsics,
    is_plausible,
    shared_intrinsics,
    without_doubtful,
    without_impossible,
    write_intrinsics,
)
from skymoor.types import Camera
from support.walks import PHONE, WIDE, reconstructed, walk, wall_points, watchers

Array = NDArray[np.float64]
OPTIONS = IntrinsicsOptions()


def by_itself(cameras: Sequence[Camera], *, seed: int = 0, points: int = 700) -> pycolmap.Reconstruction:
    """The reconstruction in which each photo has calibrated itself, from a wrong start."""
    component = reconstructed(cameras, wall_points(points), seed=seed)
    model = _regrouped(colmap_from_component(component), [], replace(OPTIONS, second_term_from=10**9))
    rng = np.random.default_rng(seed)
    for camera in model.cameras.values():
        params = camera.params
        params[0] *= 1 + rng.normal(scale=0.05)
        camera.params = params
    adjust(model)
    return model


def focal_px(model: pycolmap.Reconstruction) -> dict[str, float]:
    images = [model.image(i) for i in model.reg_image_ids()]
    return {image.name: float(model.camera(image.camera_id).params[0]) for image in images}


def centre_error_m(model: pycolmap.Reconstruction, cameras: Sequence[Camera]) -> float:
    truth = {camera.image: camera.centre for camera in cameras}
    images = [model.image(i) for i in model.reg_image_ids()]
    found = np.array([image.projection_center() for image in images])
    true = np.array([truth[image.name] for image in images])
    return float(np.linalg.norm(umeyama(found, true).apply(found) - true, axis=1).mean())


def test_photos_of_one_phone_share_intrinsics_and_security_cameras_do_not() -> None:
    cameras = [*walk(), *watchers()]
    alone = by_itself(cameras, points=200)
    together = group_intrinsics(alone, OPTIONS)
    users = {i: together.image(i).camera_id for i in together.reg_image_ids()}
    camera_of = {together.image(i).name: camera for i, camera in users.items()}
    assert len({camera_of[camera.image] for camera in walk()}) == 1
    assert len(set(camera_of.values())) == 3
    found = focal_px(together)
    assert found["walk_0"] == pytest.approx(PHONE.fx, rel=0.01)
    assert found["watcher_0"] == pytest.approx(WIDE[0].fx, rel=0.03)
    assert found["watcher_1"] == pytest.approx(WIDE[1].fx, rel=0.03)
    # A photo by itself confuses its focal length with its position.
    before, after = (centre_error_m(model, cameras) for model in (alone, together))
    assert before > 0.03
    assert 0.001 < after < 0.5 * before


def test_ids_names_and_points_stay() -> None:
    alone = by_itself([*walk(), *watchers()])
    together = group_intrinsics(alone, OPTIONS)
    assert sorted(together.reg_image_ids()) == sorted(alone.reg_image_ids())
    assert all(together.image(i).name == alone.image(i).name for i in alone.reg_image_ids())
    assert together.num_points3D() > 0.98 * alone.num_points3D()
    assert len(alone.cameras) == 11  # the first one is left as it was


def test_wrong_observations_do_not_hide_shared_intrinsics() -> None:
    """Own intrinsics adapt to a few wrong points; the shared ones must not be refused for those."""
    component = reconstructed(walk(), wall_points())
    rng, px = np.random.default_rng(2), component.obs_px.copy()
    mine = np.flatnonzero(component.obs_camera == 4)
    wrong = rng.choice(mine, len(mine) // 25, replace=False)
    px[wrong] += rng.normal(scale=15.0, size=(len(wrong), 2))
    model = _regrouped(colmap_from_component(replace(component, obs_px=px)), [], OPTIONS)
    adjust(model)
    together = group_intrinsics(model, OPTIONS)
    assert len(together.cameras) == 1
    # What did not fit is gone, and little else.
    gone = model.compute_num_observations() - together.compute_num_observations()
    assert 0.7 * len(wrong) < gone < 3 * len(wrong)


def test_too_few_photos_share_no_intrinsics() -> None:
    together = group_intrinsics(by_itself(walk(3)), OPTIONS)
    assert len(together.cameras) == 3


def test_a_photo_of_undetermined_intrinsics_is_dropped() -> None:
    cameras = [*walk(), *watchers()]
    together = group_intrinsics(by_itself(cameras), OPTIONS)
    assert without_doubtful(together, OPTIONS).num_reg_images() == 11
    strict = replace(OPTIONS, min_observations=10**6)  # of photos with lenses of their own
    kept = without_doubtful(together, strict)
    assert sorted(focal_px(kept)) == sorted(camera.image for camera in walk())
    assert len(kept.cameras) == 1
    assert without_doubtful(together, replace(OPTIONS, max_focal_sigma=1e-6)).num_reg_images() == 0
    # Diverged intrinsics are recognised by implausible values.
    lost = pycolmap.Reconstruction(together)
    camera = lost.camera(lost.image(next(i for i in lost.reg_image_ids() if "watcher" in lost.image(i).name)).camera_id)
    camera.params = [9000.0, *camera.params[1:]]
    assert not is_plausible(camera, OPTIONS)
    assert without_doubtful(lost, OPTIONS).num_reg_images() == 10


def test_one_phone_in_two_reconstructions_has_one_set_of_intrinsics() -> None:
    models = [group_intrinsics(by_itself(walk(seed=seed), seed=seed), OPTIONS) for seed in (3, 4)]
    other = [replace(c, image=f"other_{c.image}", intrinsics=replace(PHONE, fx=600.0, fy=600.0)) for c in walk()]
    models.append(group_intrinsics(by_itself(other), OPTIONS))
    camera_of = shared_intrinsics(models, OPTIONS)
    assert len(camera_of) == 18
    assert camera_of["walk_0"].params[0] == pytest.approx(PHONE.fx, rel=0.01)
    assert camera_of["other_walk_0"].params[0] == pytest.approx(600, rel=0.01)
    assert len({id(camera) for camera in camera_of.values()}) == 2


def test_intrinsics_are_written_to_their_photos_and_are_the_start_of_others(tmp_path: Path) -> None:
    with pycolmap.Database.open(tmp_path / "database.db") as db:
        for name, width in (("a", 640), ("b", 640), ("c", 300)):
            camera = pycolmap.Camera.create_from_model_name(0, "SIMPLE_RADIAL", 1.2 * width, width, 480)
            db.write_image(pycolmap.Image(name=name, camera_id=db.write_camera(camera)))
        lens = pycolmap.Camera(model="RADIAL", width=640, height=480, params=[500, 320, 240, -0.1, 0.02])
        fixed = write_intrinsics(db, {"a": lens})
        a, b, c = (db.read_camera(db.read_image_with_name(name).camera_id) for name in "abc")  # type: ignore[union-attr]
        assert fixed == {a.camera_id}
        np.testing.assert_allclose(a.params, lens.params)
        np.testing.assert_allclose(b.params, lens.params)
        assert (a.has_prior_focal_length, b.has_prior_focal_length) == (True, False)
        assert c.params[0] == 360  # a lens of another size is no start


@pytest.mark.parametrize("focal_px", [-260.0, 1.0, 1e6])
def test_photos_of_impossible_intrinsics_are_left_out(focal_px: float) -> None:
    cameras = walk(8)
    model = _regrouped(colmap_from_component(reconstructed(cameras, wall_points(300))), [], OPTIONS)
    names = {model.image(i).name for i in model.reg_image_ids()}
    assert {model.image(i).name for i in without_impossible(model).reg_image_ids()} == names
    lost = model.image(min(model.reg_image_ids()))
    params = model.camera(lost.camera_id).params
    params[0] = focal_px
    model.camera(lost.camera_id).params = params
    left = without_impossible(model)
    assert {left.image(i).name for i in left.reg_image_ids()} == names - {lost.name}
    assert np.isfinite(calibrate(left).focal_sigma_ratio)


def test_photos_whose_adjustment_diverges_end_nothing() -> None:
    """Neither the search for shared intrinsics nor the last adjustment: the photo is left out, the others stay."""
    cameras = walk(8)
    model = by_itself(cameras)
    lost = model.image(min(model.reg_image_ids()))
    params = model.camera(lost.camera_id).params
    params[0] *= -1
    model.camera(lost.camera_id).params = params
    others = {camera.image for camera in cameras} - {lost.name}
    for left in (group_intrinsics(model, OPTIONS), _adjusted(pycolmap.Reconstruction(model), [])[0]):
        found = focal_px(left)
        assert others <= found.keys() and min(found.values()) > 0
        assert 0 < centre_error_m(left, cameras) < 1
