# SPDX-License-Identifier: Apache-2.0
"""The mesh model: a nadir render of known depths, and of measured ones, against the true heights and colours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.densify import SgmDepth
from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.model import MeshBuilder, MeshModel, nadir_view
from skymoor.model.mesh._open3d import in_order
from skymoor.store._cache import read_cache, write_cache
from skymoor.types import DepthMap, Render, View
from support.flight import STANDOFF_M, Flight, as_colours, on_tent, seen_from_above, true_component, true_maps

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
LEVEL_FROM_ENU = Similarity(1 / STANDOFF_M, np.eye(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class Rendered:
    """A nadir render with the truth under its pixels, in metres."""

    render: Render
    east: Array
    north: Array
    true_height: Array
    true_rgb: Array

    @property
    def error(self) -> Array:
        return np.asarray(self.render.xyz[..., 2] * STANDOFF_M - self.true_height)

    @property
    def inner(self) -> Mask:
        """Where several photos look."""
        return np.asarray((np.abs(self.east) < 40) & (np.abs(self.north) < 35))

    @property
    def plain(self) -> Mask:
        return on_tent(self.east, self.north)


def levelled(maps: list[DepthMap]) -> list[DepthMap]:
    return [
        replace(m, camera=m.camera.transformed(LEVEL_FROM_ENU), depth=m.depth / STANDOFF_M, sigma=m.sigma / STANDOFF_M)
        for m in maps
    ]


def built(flight: Flight, maps: list[DepthMap]) -> MeshModel:
    return MeshBuilder()(true_component(flight).transformed(LEVEL_FROM_ENU), levelled(maps))


def rendered(flight: Flight, model: MeshModel) -> Rendered:
    view = nadir_view(model.surface_points, model.pixel)
    render = model.render(view)
    u, v = np.meshgrid(np.arange(view.shape[1]) + 0.5, np.arange(view.shape[0]) + 0.5)
    east, north = (view.x0 + u * view.pixel) * STANDOFF_M, -(view.y0 + v * view.pixel) * STANDOFF_M
    light, up = seen_from_above(flight.scene, east, north, pixel_m=view.pixel * STANDOFF_M)
    return Rendered(render, east, north, up.astype(np.float64), as_colours(light).astype(np.float64))


@pytest.fixture(scope="module")
def exact_model(flight: Flight) -> MeshModel:
    return built(flight, true_maps(flight))


@pytest.fixture(scope="module")
def exact(flight: Flight, exact_model: MeshModel) -> Rendered:
    """From true depths."""
    return rendered(flight, exact_model)


@pytest.fixture(scope="module")
def measured(flight: Flight) -> Rendered:
    """From stereo."""
    return rendered(flight, built(flight, list(SgmDepth()(true_component(flight), flight.photos))))


def test_pixel_is_a_photos_pixel_on_the_ground(exact_model: MeshModel) -> None:
    # 50 m and 78 m at 344 pixels, the latter foreshortened.
    assert 0.15 < exact_model.pixel * STANDOFF_M < 0.28


def test_every_ray_is_its_pixels_centre(exact: Rendered) -> None:
    known = np.isfinite(exact.render.xyz[..., 2])
    assert np.abs(exact.render.xyz[..., 0] * STANDOFF_M - exact.east)[known].max() < 1e-4
    assert np.abs(exact.render.xyz[..., 1] * STANDOFF_M - exact.north)[known].max() < 1e-4


def test_heights_of_true_depths_have_no_bias(exact: Rendered) -> None:
    sure = exact.inner & (exact.render.confidence > 0.5)
    assert sure.sum() > 0.9 * exact.inner.sum()
    error = exact.error[sure]
    # A third of a pixel of 0.26 m was the error of a wrong pixel convention: this bound is a twentieth.
    assert abs(np.median(error)) < 0.01
    assert np.median(np.abs(error)) < 0.02


def test_edges_of_houses_are_in_place(exact: Rendered) -> None:
    # Correlation of true and rendered heights is best at no shift: a plan shift of a pixel is 0.26 m.
    height = exact.error + exact.true_height
    scores = {
        (dv, du): np.nanmean(np.abs(np.roll(height, (dv, du), (0, 1)) - exact.true_height)[exact.inner])
        for dv in (-1, 0, 1)
        for du in (-1, 0, 1)
    }
    assert min(scores, key=lambda shift: scores[shift]) == (0, 0)


def test_colours_are_those_from_above(exact: Rendered, measured: Rendered) -> None:
    for case, limit in ((exact, 3.0), (measured, 5.0)):
        known = case.inner & np.isfinite(case.error)
        mine, true = case.render.rgb[known].astype(float), case.true_rgb[known]
        if case is measured:  # by photos that were metered, each for itself
            mine = np.column_stack([np.polyval(np.polyfit(a, b, 1), a) for a, b in zip(mine.T, true.T, strict=True)])
        assert 0.5 < np.median(np.abs(mine - true).mean(axis=1)) < limit
        assert np.corrcoef(mine.mean(axis=1), true.mean(axis=1))[0, 1] > 0.93


def test_measured_heights(measured: Rendered) -> None:
    sure = measured.inner & (measured.render.confidence > 0.5)
    assert sure.sum() > 0.7 * measured.inner.sum()
    error = measured.error[sure]
    assert abs(np.median(error)) < 0.04
    assert 0.005 < np.median(np.abs(error)) < 0.06


def test_what_is_confident_is_right(measured: Rendered) -> None:
    confidence = measured.render.confidence
    sure = measured.inner & (confidence > 0.5)
    assert np.percentile(np.abs(measured.error[sure]), 95) < 0.3
    bins = [(0.01, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 1.01)]
    means = []
    for low, high in bins:
        those = measured.inner & (confidence >= low) & (confidence < high) & np.isfinite(measured.error)
        assert those.sum() > 200
        means.append(float(np.abs(measured.error[those]).mean()))
    assert means[0] > means[1] > means[2] > means[3]
    assert means[0] > 10 * means[3]


def test_a_plain_roof_is_not_confident_and_wrong(measured: Rendered, exact: Rendered) -> None:
    plain = measured.plain
    assert plain.sum() > 1500
    sure = plain & (measured.render.confidence > 0.5)
    assert sure.sum() < 0.4 * plain.sum()
    assert (np.abs(measured.error[sure]) > 0.5).sum() <= 0.01 * plain.sum()
    # The same roof with true depths is confident: it is not the colour that condemns it.
    assert np.median(exact.render.confidence[exact.plain]) > 0.8


def test_holes_are_not_confident(measured: Rendered) -> None:
    confidence = measured.render.confidence
    assert ((confidence >= 0) & (confidence <= 1)).all()
    unknown = np.isnan(measured.render.xyz[..., 2])
    assert 0 < unknown.sum() < 0.4 * unknown.size
    assert not confidence[unknown].any()
    assert (np.isnan(measured.render.xyz).any(axis=-1) == np.isnan(measured.render.xyz).all(axis=-1)).all()


def test_depth_maps_that_contradict_lower_the_confidence(flight: Flight, exact_model: MeshModel) -> None:
    # Half of the photos claim a ground three metres deeper than the surface: nobody may be believed.
    liars = [
        replace(m, depth=(m.depth * 1.05).astype(np.float32)) if k % 2 else m for k, m in enumerate(exact_model.maps)
    ]
    honest = rendered(flight, exact_model)
    doubted = replace(exact_model, maps=tuple(liars)).render(honest.render.view)
    inner = honest.inner
    assert np.median(doubted.confidence[inner]) < 0.6 * np.median(honest.render.confidence[inner])


def test_agreeing_but_uncertain_depths_are_not_believed(exact_model: MeshModel, exact: Rendered) -> None:
    unsure = [replace(m, sigma=(0.015 * m.depth).astype(np.float32)) for m in exact_model.maps]
    doubted = replace(exact_model, maps=tuple(unsure)).render(exact.render.view)
    assert np.median(doubted.confidence[exact.inner]) < 0.4
    assert np.median(exact.render.confidence[exact.inner]) > 0.9


def test_an_oblique_view_hits_the_same_surface(flight: Flight, exact_model: MeshModel) -> None:
    tilt = np.radians(30)
    c, s = np.cos(tilt), np.sin(tilt)
    rotation = np.array([[1, 0, 0], [0, -c, -s], [0, s, -c]])
    view = View(rotation, -20 / STANDOFF_M, -15 / STANDOFF_M, 0.25 / STANDOFF_M, (120, 160))
    render = exact_model.render(view)
    xyz = render.xyz.reshape(-1, 3).astype(np.float64)
    sure = render.confidence.ravel() > 0.6
    assert sure.mean() > 0.8
    on_ray = xyz @ rotation.T
    u, v = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    assert np.abs(on_ray[sure, 0] - (view.x0 + u.ravel()[sure] * view.pixel)).max() < 1e-5
    assert np.abs(on_ray[sure, 1] - (view.y0 + v.ravel()[sure] * view.pixel)).max() < 1e-5
    world = xyz[sure] * STANDOFF_M
    gap = world[:, 2] - seen_from_above(flight.scene, world[:, 0], world[:, 1])[1]
    assert np.median(np.abs(gap)) < 0.03  # walls stand below the roofs that are seen from above


def test_a_model_survives_the_cache(exact_model: MeshModel, exact: Rendered, tmp_path: Path) -> None:
    write_cache(tmp_path / "model.npz", None, exact_model)
    again = read_cache(tmp_path / "model.npz")[1].render(exact.render.view)
    np.testing.assert_array_equal(again.rgb, exact.render.rgb)
    np.testing.assert_array_equal(again.confidence, exact.render.confidence)


@pytest.mark.parametrize("case", ["no maps", "unsure", "one"])
def test_depths_without_a_common_surface_are_refused(flight: Flight, exact_model: MeshModel, case: str) -> None:
    one = exact_model.maps[0]
    unsure = replace(one, sigma=np.full_like(one.depth, 1.0))
    maps = {"no maps": [], "unsure": [unsure, unsure], "one": [one, unsure]}[case]
    with pytest.raises(DegenerateGeometry):
        MeshBuilder()(true_component(flight).transformed(LEVEL_FROM_ENU), maps)


def test_the_order_of_a_mesh_is_not_left_to_threads(exact_model: MeshModel, rng: np.random.Generator) -> None:
    vertices, triangles = exact_model.vertices, exact_model.triangles
    shuffle = rng.permutation(len(vertices))
    place = np.argsort(shuffle)
    turned = np.stack(
        [np.roll(one, k) for one, k in zip(place[triangles], rng.integers(0, 3, len(triangles)), strict=True)]
    )
    other = in_order(vertices[shuffle], turned[rng.permutation(len(turned))].astype(np.int32))
    np.testing.assert_array_equal(other[0], vertices)
    np.testing.assert_array_equal(other[1], triangles)
    normals = np.cross(*(vertices[triangles[:, k]] - vertices[triangles[:, 0]] for k in (1, 2)))
    assert np.median(normals[:, 2]) > 0  # and which side is outside has not changed
