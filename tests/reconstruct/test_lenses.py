# SPDX-License-Identifier: Apache-2.0
"""Photos of two lenses in one flight are told apart; those of one lens from two heights are not taken for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from skymoor.engines.colmap import colmap_from_component
from skymoor.geometry import Intrinsics
from skymoor.reconstruct.calibration import adjust, calibrate, widened
from skymoor.reconstruct.lens_groups import ScaleGroup, copy_with_cameras, scale_groups
from skymoor.reconstruct.lenses import HEIGHT_SPREAD, Lens, is_own, set_focal, tie_focal_lengths
from skymoor.reconstruct.protocol import ViewGraph, colmap_name
from skymoor.types import Camera, Component, Photos
from support.blocks import LENS, ground_points, look_at, observed

TELE = replace(LENS, fx=2 * LENS.fx, fy=2 * LENS.fy)
FLYING_M = 60.0


def flight(*, every: int = 3, lens: Intrinsics = TELE, height_m: float = FLYING_M) -> list[Camera]:
    """Sixteen photos from above, of which every n-th is through another lens, or from another height."""
    rng = np.random.default_rng(6)
    cameras = []
    for k in range(16):
        other = k % every == 1
        east, north = -24.0 + 16 * (k % 4), -24.0 + 16 * (k // 4)
        up = height_m if other else FLYING_M * (1 + rng.normal(scale=0.02))
        target = np.array([east, north, 0]) + [*rng.normal(scale=1.5, size=2), 0]
        pose = look_at(np.array([east, north, up]), target, up=np.array([0.0, 1, 0]), roll_deg=rng.normal(scale=2))
        cameras.append(Camera(f"{k}", lens if other else LENS, pose))
    return cameras


def tie_points(cameras: Sequence[Camera], *, relief_m: float, noise_px: float = 0.3) -> Component:
    points = ground_points(1500, relief_m=relief_m, extent_m=50)
    often = np.bincount(observed(cameras, points).obs_point, minlength=len(points)) >= 2
    return observed(cameras, points[often], noise_px=noise_px)


def graph_of(component: Component, wrong: float = 0.0) -> ViewGraph:
    """Matches of all pairs, of which a share are wrong."""
    rng, n = np.random.default_rng(1), len(component.cameras)
    px = np.full((n, len(component.points), 2), np.nan)
    px[component.obs_camera, component.obs_point] = component.obs_px
    pairs, matches = [], []
    for i in range(n):
        for j in range(i + 1, n):
            both = np.flatnonzero(np.isfinite(px[i, :, 0]) & np.isfinite(px[j, :, 0]))
            if len(both) >= 8:
                other = np.where(rng.random(len(both)) < wrong, rng.permutation(both), both)
                pairs.append((i, j))
                matches.append(np.hstack([px[i, both], px[j, other]]))
    sizes = tuple((camera.intrinsics.width, camera.intrinsics.height) for camera in component.cameras)
    return ViewGraph(Photos(tuple(c.image for c in component.cameras), sizes, unread), tuple(pairs), tuple(matches), ())


def unread(name: str) -> np.ndarray:
    raise AssertionError(name)


def model_of(component: Component, *, focal_ratio: float = 1.0) -> pycolmap.Reconstruction:
    """As mapping leaves it with a camera for each group: the second one's focal length is wrong by so much."""
    model = colmap_from_component(component)
    set_focal(model, 2, focal_ratio * model.camera(2).mean_focal_length())
    adjust(model, max_iterations=200)
    return model


@pytest.mark.parametrize("wrong", [0.0, 0.1])
def test_scales_tell_groups_apart(wrong: float) -> None:
    first, second = scale_groups(graph_of(tie_points(flight(), relief_m=8.0), wrong))
    assert second.photos == (1, 4, 7, 10, 13) and (first.ratio, first.reference, second.reference) == (1.0, 0, 0)
    assert len(first.photos) == 11
    assert second.ratio == pytest.approx(2.0, rel=0.05)


def test_photos_of_one_scale_are_one_group() -> None:
    """Heights that vary by a tenth, and slopes, are no other lens; nor is a single photo of wrong matches."""
    assert scale_groups(graph_of(tie_points(flight(lens=LENS, height_m=1.1 * FLYING_M), relief_m=15.0))) == []
    assert scale_groups(graph_of(tie_points(flight(every=14), relief_m=8.0))) != []  # two photos
    assert scale_groups(graph_of(tie_points(flight(every=15), relief_m=8.0))) == []  # one
    assert scale_groups(ViewGraph(Photos((), (), unread), (), (), ())) == []


def test_another_lens_is_found_by_relief_and_gets_its_focal_length() -> None:
    component = tie_points(flight(), relief_m=8.0)
    lens = Lens(2, 1, 2.0)
    model = model_of(component, focal_ratio=1.1)
    assert is_own(model, lens)
    assert tie_focal_lengths(model, [lens]) == [2]
    ratio = model.camera(2).mean_focal_length() / model.camera(1).mean_focal_length()
    assert ratio == pytest.approx(2.0, rel=1e-3)
    # Heights within the flight come back: a tele photo is as high as the others, not half as high.
    heights = {model.image(i).name: abs(model.image(i).projection_center()[2]) for i in model.reg_image_ids()}
    tele, wide = (
        np.median([heights[str(k)] for k in range(16) if (k % 3 == 1) is is_tele]) for is_tele in (True, False)
    )
    assert tele == pytest.approx(wide, rel=0.05)
    before = model.camera(2).mean_focal_length()
    adjust(model, fixed=[2])
    assert model.camera(2).mean_focal_length() == before


@pytest.mark.parametrize("relief_m", [8.0, 15.0])
def test_another_height_is_no_other_lens(relief_m: float) -> None:
    component = tie_points(flight(lens=LENS, height_m=FLYING_M / 2), relief_m=relief_m)
    # Mapping has given the low ones a camera, which takes some other focal length.
    apart = replace(
        component,
        cameras=tuple(
            replace(c, intrinsics=replace(LENS, fx=1.01 * LENS.fx, fy=1.01 * LENS.fy)) if k % 3 == 1 else c
            for k, c in enumerate(component.cameras)
        ),
    )
    _, second = scale_groups(graph_of(component))
    assert second.ratio == pytest.approx(2.0, rel=0.2)
    assert not is_own(model_of(apart, focal_ratio=1.2), Lens(2, 1, second.ratio))


def test_both_differ_and_relief_is_large_the_scale_has_no_say() -> None:
    """Another lens from another height: relief of a third of the flying height gives the focal length itself."""
    component = tie_points(flight(height_m=1.6 * FLYING_M), relief_m=22.0, noise_px=0.1)
    lens = Lens(2, 1, 1.25)
    model = model_of(component)
    assert is_own(model, lens)
    assert tie_focal_lengths(model, [lens]) == []
    ratio = model.camera(2).mean_focal_length() / model.camera(1).mean_focal_length()
    assert ratio == pytest.approx(2.0, rel=0.03)


def test_a_model_without_both_lenses_decides_nothing() -> None:
    model = model_of(tie_points(flight(), relief_m=8.0))
    assert not is_own(model, Lens(7, 1, 2.0))
    assert tie_focal_lengths(model, [Lens(7, 1, 2.0)]) == []


def test_a_tied_focal_length_is_less_certain() -> None:
    calibration = calibrate(model_of(tie_points(flight(), relief_m=8.0)))
    wide = widened(calibration, HEIGHT_SPREAD)
    assert wide.focal_sigma == pytest.approx(np.hypot(calibration.focal_sigma, HEIGHT_SPREAD), rel=0.1)
    assert wide.uncertain


def test_a_database_with_a_camera_for_each_group(tmp_path: Path) -> None:
    sizes = ((640, 480), (640, 480), (300, 200), (640, 480), (640, 480))
    photos = Photos(tuple("abcde"), sizes, unread)
    rng, ids = np.random.default_rng(0), {}
    with pycolmap.Database.open(tmp_path / "old.db") as db:
        for k in (2, 0, 1, 4, 3):
            camera = pycolmap.Camera.create_from_model_name(0, "RADIAL", 500.0, *sizes[k])
            name = colmap_name(k, sizes[k])
            ids[k] = db.write_image(pycolmap.Image(name=name, camera_id=db.write_camera(camera)))
            db.write_keypoints(ids[k], (100 * k + rng.uniform(size=(5, 2))).astype(np.float32))
        geometry = pycolmap.TwoViewGeometry()
        geometry.inlier_matches = np.array([[0, 1], [3, 2]], np.uint32)
        db.write_two_view_geometry(ids[4], ids[1], geometry)
    groups = [ScaleGroup((0, 4), 1.0, 0), ScaleGroup((1, 3), 2.0, 0)]
    (lens,) = copy_with_cameras(tmp_path / "old.db", tmp_path / "new.db", photos, groups)
    with pycolmap.Database.open(tmp_path / "new.db") as db:
        images = [db.read_image_with_name(colmap_name(k, size)) for k, size in enumerate(sizes)]
        cameras = [image.camera_id for image in images]
        assert cameras[0] == cameras[4] == lens.reference_id and cameras[1] == cameras[3] == lens.camera_id
        assert len(set(cameras)) == 3 and lens.ratio == 2.0
        assert [db.read_keypoints(image.image_id)[0, 0] // 100 for image in images] == [0, 1, 2, 3, 4]
        found = db.read_two_view_geometry(images[4].image_id, images[1].image_id).inlier_matches
        np.testing.assert_array_equal(found, [[0, 1], [3, 2]])
