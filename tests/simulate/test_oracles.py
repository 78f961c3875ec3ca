# SPDX-License-Identifier: Apache-2.0
"""Oracles give the errors that they are asked for, no more and no less; offline engines come near them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

from skymoor.densify import DepthEstimator, MonocularDepth, SgmDepth
from skymoor.errors import InputError
from skymoor.match import DenseMatcher, StructuralMatcher
from skymoor.match.cyclic import cycle_error_px
from skymoor.orient import GroundLabeler
from skymoor.reconstruct import PairMatcher, ReconstructOptions, SiftMatcher, reconstruct
from skymoor.reconstruct.protocol import colmap_name
from skymoor.simulate.capture.shots import airborne_shots, true_view
from skymoor.simulate.light.photo import take_photo, true_depth, true_labels
from skymoor.simulate.mesh import GROUND_LABELS, stream
from skymoor.simulate.oracles import (
    OracleDepth,
    OracleGroundLabeler,
    OracleMatcher,
    OracleMonocularDepth,
    OraclePairMatcher,
)
from skymoor.simulate.plan import dates_of
from skymoor.simulate.site import true_enu_from_sfm
from skymoor.simulate.world import World
from skymoor.types import Component, DepthMap, Image, Photos, Raster, no_progress

Array = NDArray[np.float64]
MakeWorld = Callable[..., World]

WIDTH = 320


@pytest.fixture(scope="module")
def flown(make_world: MakeWorld) -> World:
    return make_world(airborne=12, groups=0, security=0, photo_width=WIDTH)


@pytest.fixture(scope="module")
def photos(flown: World) -> Photos:
    scene = flown.scene(dates_of(flown.options).airborne)
    images: dict[str, Image] = {}
    for shot in airborne_shots(flown):
        rng = stream(0, shot.camera.image)
        images[shot.camera.image] = take_photo(scene, shot.camera, shot.sensor, rng, samples=2)
    sizes = tuple((image.shape[1], image.shape[0]) for image in images.values())
    return Photos(tuple(images), sizes, images.__getitem__)


@pytest.fixture(scope="module")
def component(flown: World, photos: Photos) -> Component:
    return rebuilt(OraclePairMatcher(flown, colmap_name, landmarks=60), photos)


def rebuilt(matcher: PairMatcher, photos: Photos) -> Component:
    (component,) = reconstruct(photos, ReconstructOptions(matcher=matcher), seed=1)
    return component


def centre_errors_m(component: Component, world: World) -> Array:
    cameras = [true_view(world, camera.image)[0] for camera in component.cameras]
    found = true_enu_from_sfm(component, cameras).apply(component.centres)
    errors: Array = np.linalg.norm(found - [camera.centre for camera in cameras], axis=1)
    return errors


def depth_errors(maps: list[DepthMap], component: Component, world: World) -> Array:
    """Relative errors of all depths."""
    views = [true_view(world, camera.image) for camera in component.cameras]
    enu_from_sfm = true_enu_from_sfm(component, [camera for camera, _ in views])
    errors = []
    for depth_map in maps:
        exact = true_depth(views[0][1], depth_map.camera.transformed(enu_from_sfm)) / enu_from_sfm.scale
        errors.append((depth_map.depth / exact - 1).ravel())
    return np.concatenate(errors)


def positions_from_above(world: World, shift_m: float) -> tuple[Raster, NDArray[np.float32]]:
    """A nadir picture of 0.4 m pixels, and the true position of each pixel."""
    scene = world.scene(dates_of(world.options).airborne)
    u, v = np.meshgrid(np.arange(150), np.arange(120))
    origins = np.stack([0.4 * u - 30 + shift_m, 24 - 0.4 * v, np.full(u.shape, 60.0)], axis=-1).reshape(-1, 3)
    down = np.tile([0.0, 0.0, -1.0], (len(origins), 1))
    up = 60 - scene.cast(origins, down).distance
    light = scene.radiance(origins, down, pixel_m=0.4)
    xyz = np.column_stack([origins[:, :2], up]).reshape(120, 150, 3).astype(np.float32)
    rgb = (255 * np.clip(light, 0, 1) ** 0.5).astype(np.uint8).reshape(120, 150, 3)
    height = (xyz[..., 2] / 0.4).astype(np.float32)
    return Raster(rgb, np.ones((120, 150), bool), height), xyz


def conforms(world: World, photos: Photos) -> None:
    """Read by the type checker: every oracle can take its engine's place."""
    nowhere = np.zeros((2, 2, 3), np.float32)
    _pairs: PairMatcher = OraclePairMatcher(world, colmap_name)
    _depths: DepthEstimator = OracleDepth(world)
    _single: MonocularDepth = OracleMonocularDepth(world, photos.names, photos.read)
    _ground: GroundLabeler = OracleGroundLabeler(world, photos.names, photos.read)
    _dense: DenseMatcher = OracleMatcher(nowhere, nowhere)


@pytest.mark.parametrize("engine", ["oracle", "sift"])
def test_pair_matchers_lead_to_the_true_cameras(engine: str, flown: World, photos: Photos) -> None:
    oracle = OraclePairMatcher(flown, colmap_name, landmarks=60)
    matcher: PairMatcher = oracle if engine == "oracle" else SiftMatcher(max_features=1500)
    found = rebuilt(matcher, photos)
    assert len(found.cameras) == 12
    assert 0.001 < np.median(centre_errors_m(found, flown)) < 1.0


def entered(matcher: OraclePairMatcher, photos: Photos, folder: Path) -> Path:
    folder.mkdir()
    steps: list[int] = []
    matcher(photos, folder / "a.db", folder, seed=3, progress=lambda done, _: steps.append(done))
    assert steps == list(range(1, len(photos) + 2))
    return folder / "a.db"


def test_key_points_are_as_noisy_as_asked_for(flown: World, photos: Photos, tmp_path: Path) -> None:
    found = []
    for noise in (0.0, 0.8):
        path = entered(
            OraclePairMatcher(flown, colmap_name, landmarks=40, noise_px=noise), photos, tmp_path / str(noise)
        )
        with pycolmap.Database.open(path) as db:
            found.append(np.concatenate([db.read_keypoints(image.image_id)[:, :2] for image in db.read_all_images()]))
    assert len(found[0]) > 1000
    assert (found[1] - found[0]).std() == pytest.approx(0.8, rel=0.05)


def test_outliers_among_matches_are_there_and_are_seen_through(flown: World, photos: Photos, tmp_path: Path) -> None:
    verified = []
    for share in (0.0, 0.25):
        matcher = OraclePairMatcher(flown, colmap_name, landmarks=60, outlier_share=share, noise_px=0.0)
        with pycolmap.Database.open(entered(matcher, photos, tmp_path / str(share))) as db:
            assert db.num_images() == len(photos) and db.num_cameras() == 1
            matched = [len(matches) for matches in db.read_all_matches()[1]]
            inliers = sum(len(found.inlier_matches) for found in db.read_two_view_geometries()[1])
        assert len(matched) > 20
        verified.append(inliers / sum(matched))
    # Without outliers the lens costs a few, as the test of a pair knows of none.
    assert verified[0] > 0.8
    assert verified[1] / verified[0] == pytest.approx(0.75, abs=0.07)


def test_photos_of_elsewhere_are_refused(flown: World, photos: Photos, component: Component) -> None:
    stranger = Photos(("airborne/x.jpg",), ((WIDTH, 240),), photos.read)
    with pytest.raises(InputError, match=r"x\.jpg"):
        OraclePairMatcher(flown, colmap_name)(stranger, None, None, seed=0, progress=no_progress)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="does not know this picture"):
        OracleGroundLabeler(flown, photos.names, photos.read)(np.zeros((240, WIDTH, 3), np.uint8))


@pytest.mark.parametrize(("engine", "low", "high"), [("oracle", 0.0, 1e-5), ("sgm", 1e-5, 0.01)])
def test_depth_estimators_find_the_surface(
    engine: str, low: float, high: float, flown: World, photos: Photos, component: Component
) -> None:
    estimator: DepthEstimator = OracleDepth(flown, max_px=WIDTH) if engine == "oracle" else SgmDepth(max_px=WIDTH)
    maps = list(estimator(component, photos, progress=no_progress))
    error = depth_errors(maps, component, flown)
    assert low <= np.nanmedian(np.abs(error)) < high
    assert np.isfinite(error).mean() > (0.3 if engine == "sgm" else 0.9)
    for depth_map in maps:
        i = depth_map.camera.intrinsics
        assert not any(i.distortion) and depth_map.depth.shape == (i.height, i.width) == depth_map.rgb.shape[:2]


def test_errors_of_depths_are_those_asked_for(flown: World, photos: Photos, component: Component) -> None:
    oracle = OracleDepth(flown, max_px=160, noise_ratio=0.01, outlier_share=0.1, missing_share=0.2)
    error = depth_errors(list(oracle(component, photos)), component, flown)
    assert np.isnan(error).mean() == pytest.approx(0.2, abs=0.05)
    error = error[np.isfinite(error)]
    assert np.mean(np.abs(error) > 0.05) == pytest.approx(0.09, abs=0.015)
    assert 1.4826 * np.median(np.abs(error)) == pytest.approx(0.011, rel=0.15)


def test_depth_of_one_photo_is_the_truth_but_for_scale_and_zero(flown: World, photos: Photos) -> None:
    for noise in (0.0, 0.05):
        oracle = OracleMonocularDepth(flown, photos.names, photos.read, noise=noise)
        name = photos.names[4]
        camera, scene = true_view(flown, name)
        exact = true_depth(scene, camera).ravel().astype(float)
        relative = oracle(photos.read(name)).ravel()
        low, high = np.nanpercentile(exact, (5, 95))
        good = (exact > low) & (exact < high)
        slope, zero = np.polyfit(exact[good], relative[good], 1)
        assert slope > 0
        left = relative[good] - slope * exact[good] - zero
        assert left.std() == pytest.approx(noise, rel=0.1, abs=1e-4)


def test_labels_are_the_truth_but_for_the_share_asked_for(flown: World, photos: Photos) -> None:
    name = photos.names[2]
    camera, scene = true_view(flown, name)
    exact = np.isin(true_labels(scene, camera), GROUND_LABELS)
    assert 0.2 < exact.mean() < 0.99
    for share in (0.0, 0.2):
        found = OracleGroundLabeler(flown, photos.names, photos.read, wrong_share=share)(photos.read(name))
        assert (found != exact).mean() == pytest.approx(share, abs=0.06 * bool(share))


@pytest.mark.parametrize(("engine", "limit_px"), [("oracle", 0.05), ("structural", 0.5)])
def test_dense_matchers_find_a_planted_shift(engine: str, limit_px: float, flown: World) -> None:
    (a, xyz_a), (b, xyz_b) = positions_from_above(flown, 0.0), positions_from_above(flown, 1.3)
    matcher: DenseMatcher = OracleMatcher(xyz_a, xyz_b) if engine == "oracle" else StructuralMatcher()
    warp = matcher(a, b)
    own = np.stack(np.meshgrid(np.arange(150) + 0.5, np.arange(120) + 0.5), axis=-1)
    inner = np.s_[20:-20, 20:-20]
    for flow, confidence, shift in (
        (warp.b_from_a, warp.confidence_a, -3.25),
        (warp.a_from_b, warp.confidence_b, 3.25),
    ):
        good = confidence[inner] > 0.2
        assert good.mean() > 0.5
        error = (flow - own - [shift, 0.0])[inner][good]
        assert np.median(np.linalg.norm(error, axis=1)) < limit_px
    if engine == "oracle":  # what only one picture shows has no answer
        assert warp.confidence_a[:, 0].max() == 0 and warp.confidence_b[:, -1].max() == 0


def test_errors_of_matches_are_those_asked_for(flown: World) -> None:
    (a, xyz_a), (b, xyz_b) = positions_from_above(flown, 0.0), positions_from_above(flown, 1.3)
    clean = OracleMatcher(xyz_a, xyz_b)(a, b)
    noisy = OracleMatcher(xyz_a, xyz_b, noise_px=0.7, outlier_share=0.1)(a, b)
    both = (clean.confidence_a > 0) & (noisy.confidence_a > 0)
    error = (noisy.b_from_a - clean.b_from_a)[both]
    wrong = np.linalg.norm(error, axis=1) > 5
    assert wrong.mean() == pytest.approx(0.1, abs=0.02)
    assert error[~wrong].std() == pytest.approx(0.7, rel=0.05)
    # The way back is a mixture of one to four answers, each of which can be wrong.
    far = cycle_error_px(noisy)[both] > 5
    assert 1 - 0.9**2 < far.mean() < 1 - 0.9**5


def test_masked_pixels_are_not_matched(flown: World) -> None:
    (a, xyz_a), (b, xyz_b) = positions_from_above(flown, 0.0), positions_from_above(flown, 0.0)
    half = Raster(b.rgb, np.arange(150)[None] < np.full((120, 1), 75), b.height)
    warp = OracleMatcher(xyz_a, xyz_b)(a, half)
    assert warp.confidence_a[:, 80:].max() == 0 and warp.confidence_a[:, :70].mean() > 0.95
    assert warp.confidence_b[:, 75:].max() == 0
    blind = np.full_like(xyz_b, np.nan)
    assert OracleMatcher(xyz_a, blind)(a, b).confidence_a.max() == 0
    with pytest.raises(ValueError, match="other pictures"):
        OracleMatcher(xyz_a[:-1], xyz_b)(a, b)
