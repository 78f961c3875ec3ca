# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.geometry import Intrinsics, Similarity, umeyama
from skymoor.reconstruct import ReconstructOptions, SiftMatcher, ViewGraph, ground_options, reconstruct
from skymoor.reconstruct.mapping import _distinct, _mapping_options
from skymoor.simulate.light.photo import Sensor, take_photo
from skymoor.types import Camera, Component, Image, Photos
from support.flight import STANDOFF_M, Flight

Array = NDArray[np.float64]


def photos_of(images: dict[str, Image]) -> Photos:
    sizes = tuple((image.shape[1], image.shape[0]) for image in images.values())
    return Photos(tuple(images), sizes, images.__getitem__)


def photos_from_above(flight: Flight) -> Photos:
    return photos_of({flight.cameras[k].image: flight.images[flight.cameras[k].image] for k in flight.from_above})


def true_cameras(component: Component, flight: Flight) -> list[Camera]:
    by_name = {camera.image.rpartition("/")[2]: camera for camera in flight.cameras}
    return [by_name[camera.image.rpartition("/")[2]] for camera in component.cameras]


def enu_from_sfm(component: Component, flight: Flight) -> Similarity:
    return umeyama(component.centres, np.array([camera.centre for camera in true_cameras(component, flight)]))


def camera_errors_m(component: Component, flight: Flight) -> Array:
    truth = np.array([camera.centre for camera in true_cameras(component, flight)])
    return np.linalg.norm(enu_from_sfm(component, flight).apply(component.centres) - truth, axis=1)


@pytest.fixture(scope="module")
def component(flight: Flight) -> Component:
    shares: list[float] = []
    components = reconstruct(flight.photos, seed=1, progress=lambda done, of: shares.append(done / of))
    assert len(components) == 1
    assert shares == sorted(shares) and shares[0] > 0 and shares[-1] == 1
    return components[0]


def test_every_photo_is_in_the_right_place(component: Component, flight: Flight) -> None:
    assert sorted(c.image for c in component.cameras) == sorted(flight.photos.names)
    error = camera_errors_m(component, flight)
    assert error.mean() < 0.002 * STANDOFF_M
    assert error.mean() > 1e-5 * STANDOFF_M
    similarity = enu_from_sfm(component, flight)
    for camera, truth in zip(component.cameras, true_cameras(component, flight), strict=True):
        turn = camera.transformed(similarity).cam_from_world.rotation @ truth.cam_from_world.rotation.T
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 0.3


def test_the_lens_is_found_and_certain(component: Component, flight: Flight) -> None:
    found, true = component.cameras[0].intrinsics, flight.cameras[0].intrinsics
    # A ring that looks down at 55 degrees leaves the lens less certain than a flatter one would.
    assert found.fx == pytest.approx(true.fx, rel=0.01)
    assert found.cx == pytest.approx(true.cx, abs=2.0) and found.cy == pytest.approx(true.cy, abs=2.0)
    assert found.distortion[0] == pytest.approx(true.distortion[0], abs=0.01)
    assert (found.width, found.height) == (400, 300)
    assert component.calibration is not None
    assert component.calibration.shared_intrinsics and not component.calibration.uncertain
    assert component.calibration.focal_px == pytest.approx(found.fx)
    ratio = true.fx / found.fx
    assert component.calibration.focal_low_ratio < ratio < component.calibration.focal_high_ratio


def test_points_lie_on_the_surface_in_its_colours(component: Component, flight: Flight) -> None:
    assert len(component.points) > 1500
    xyz = enu_from_sfm(component, flight).apply(component.points)
    centre = true_cameras(component, flight)[0].centre
    t = flight.scene.cast(centre, xyz - centre).distance
    mine = np.unique(component.obs_point[component.obs_camera == 0])
    assert np.median(np.abs(t[mine] - 1)) < 0.002
    grey = component.colours.astype(float).mean(axis=1)
    seen = np.array(
        [
            flight.images[component.cameras[c].image][int(v), int(u)].mean()
            for c, (u, v) in zip(component.obs_camera, component.obs_px, strict=True)
        ]
    )
    assert np.corrcoef(grey[component.obs_point], seen)[0, 1] > 0.8


def test_observations_agree_with_the_cameras(component: Component) -> None:
    assert 0.01 < component.reprojection_px < 0.5
    for k, camera in enumerate(component.cameras):
        mine = component.obs_camera == k
        xyz = camera.cam_from_world.apply(component.points[component.obs_point[mine]])
        gap = np.linalg.norm(camera.intrinsics.px_from_cam(xyz) - component.obs_px[mine], axis=1)
        assert np.median(gap) < 0.5


def test_two_places_are_two_components(flight: Flight) -> None:
    # Four of the cameras look at a neighbourhood 170 m away instead.
    away = Similarity(1.0, np.eye(3), np.array([170.0, 0.0, 0.0]))
    elsewhere = [flight.cameras[k] for k in flight.around[:4]]
    here = [flight.cameras[k] for k in (*flight.around[4:7], *flight.from_above[:2])]
    rng = np.random.default_rng(1)
    images = {f"b/{c.image}": take_photo(flight.scene, c.transformed(away), Sensor(), rng) for c in elsewhere}
    images |= {f"a/{c.image}": flight.images[c.image] for c in here}
    matcher = SiftMatcher(max_features=2000)
    first, second = reconstruct(photos_of(images), ReconstructOptions(matcher), seed=2)
    assert {c.image for c in first.cameras} == {f"a/{c.image}" for c in here}
    assert {c.image for c in second.cameras} == {f"b/{c.image}" for c in elsewhere}
    for component in (first, second):
        assert camera_errors_m(component, flight).mean() < 0.01 * STANDOFF_M


def test_the_same_seed_gives_the_same_reconstruction(flight: Flight) -> None:
    some = photos_from_above(flight)
    options = ReconstructOptions(SiftMatcher(max_features=1500))
    (a,), (b,) = (reconstruct(some, options, seed=5) for _ in range(2))
    assert [c.image for c in a.cameras] == [c.image for c in b.cameras] == list(some.names)
    np.testing.assert_array_equal(a.centres, b.centres)
    np.testing.assert_array_equal(a.points, b.points)
    assert a.calibration == b.calibration


def test_photos_of_nothing_in_common_give_no_component() -> None:
    rng = np.random.default_rng(0)
    noise = {f"{k}.jpg": rng.integers(0, 255, (120, 160, 3)).astype(np.uint8) for k in range(3)}
    assert reconstruct(photos_of(noise), seed=0) == []


@dataclass(frozen=True)
class Model:
    """As much of a COLMAP model as the rule looks at."""

    images: frozenset[int]

    def num_reg_images(self) -> int:
        return len(self.images)

    def reg_image_ids(self) -> list[int]:
        return sorted(self.images)


def test_models_whose_photos_are_all_in_larger_ones_are_dropped() -> None:
    sets = [{7, 8, 9}, {1, 2, 3, 4, 5}, {2, 3, 4}, {5, 6, 7, 8}, {4, 5, 6}]
    kept = _distinct([Model(frozenset(s)) for s in sets])  # type: ignore[misc]
    # {4, 5, 6} lies in no other alone, but all of its photos are known already.
    assert [m.reg_image_ids() for m in kept] == [[1, 2, 3, 4, 5], [5, 6, 7, 8], [7, 8, 9]]
    assert _distinct([]) == []


def test_large_sets_are_adjusted_less_often() -> None:
    few, many = (_mapping_options(ReconstructOptions(), count, seed=0) for count in (100, 101))
    assert few.ba_global_frames_ratio == few.ba_global_points_ratio == 1.1
    assert many.ba_global_frames_ratio == many.ba_global_points_ratio == 1.3


def test_photos_of_two_sizes_are_two_cameras(flight: Flight) -> None:
    names = [flight.cameras[k].image for k in flight.from_above]
    images = {name: flight.images[name] for name in names}
    images[names[0]] = images[names[0]][:, :390]
    (component,) = reconstruct(photos_of(images), ReconstructOptions(SiftMatcher(max_features=1500)), seed=5)
    widths = {c.image: c.intrinsics.width for c in component.cameras}
    assert widths[names[0]] == 390 and widths[names[1]] == 400
    assert component.calibration is not None and not component.calibration.shared_intrinsics


def through(image: Image, lens: Intrinsics, other: Intrinsics) -> Image:
    """A photo as another lens would have taken it."""
    pixels = np.stack(np.meshgrid(np.arange(other.width), np.arange(other.height)), axis=-1) + 0.5
    source = lens.px_from_cam(other.rays(pixels.reshape(-1, 2))).reshape(*pixels.shape).astype(np.float32) - 0.5
    return np.asarray(cv2.remap(image, source[..., 0], source[..., 1], cv2.INTER_CUBIC), np.uint8)


@dataclass(frozen=True)
class Without:
    """Believes no pair with this photo."""

    name: str
    rounds: int = 3

    def __call__(self, graph: ViewGraph) -> list[int]:
        assert graph.components
        photo = graph.photos.names.index(self.name)
        return [k for k, pair in enumerate(graph.pairs) if photo not in pair]


def test_mixed_cameras_are_separated_and_pairs_are_filtered(flight: Flight) -> None:
    names = [flight.cameras[k].image for k in (*flight.around[:6], *flight.from_above[:4])]
    lens, tele = flight.cameras[0].intrinsics, replace(flight.cameras[0].intrinsics, fx=640.0, fy=640.0)
    tele = replace(tele, distortion=(-0.25, 0.0, 0.0, 0.0))
    images = {name: flight.images[name] for name in names}
    images[names[2]] = through(images[names[2]], lens, tele)
    matcher = replace(SiftMatcher(), max_features=1500, shared_camera=False)
    options = replace(ground_options(), matcher=matcher, pair_filter=Without(names[-1]))
    (component,) = reconstruct(photos_of(images), options, seed=3)
    found = {camera.image: camera.intrinsics for camera in component.cameras}
    assert sorted(found) == sorted(names[:-1])
    others = {lens for name, lens in found.items() if name != names[2]}
    assert len(others) == 1
    assert others.pop().fx == pytest.approx(lens.fx, rel=0.02)
    assert found[names[2]].fx == pytest.approx(tele.fx, rel=0.03)
    assert found[names[2]].distortion[0] == pytest.approx(-0.25, abs=0.15)  # a narrow view says little about it
    assert camera_errors_m(component, flight).mean() < 0.004 * STANDOFF_M
