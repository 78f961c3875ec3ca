# SPDX-License-Identifier: Apache-2.0
"""Pixels to points: exact where both surfaces are known and smooth; in plan alone where the reference is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.geo import EnuFrame, Grid
from skymoor.registration import LiftOptions, lift
from skymoor.registration.lift import height_step
from skymoor.types import Matches2D, Matches3D, Reference, Render, View

Array = NDArray[np.float64]
METRES_PER_LEVEL = 50.0
VIEW = View(np.diag([1.0, -1.0, -1.0]), -0.8, -0.6, 0.005, (240, 320))  # pixels of 0.25 m
GRID = Grid(-60.0, 50.0, 0.5, (200, 240))


def model_height(x: Array, y: Array) -> Array:
    return np.asarray(0.1 * x - 0.2 * y + 0.01)


def earth_height(east: Array, north: Array) -> Array:
    return np.asarray(5 + 0.05 * east + 0.1 * north)


@pytest.fixture
def render() -> Render:
    u, v = np.meshgrid(np.arange(320) + 0.5, np.arange(240) + 0.5)
    x, y = VIEW.x0 + u * VIEW.pixel, -(VIEW.y0 + v * VIEW.pixel)
    xyz = np.stack([x, y, model_height(x, y)], axis=-1).astype(np.float32)
    return Render(VIEW, np.zeros((240, 320, 3), np.uint8), xyz, np.ones((240, 320), np.float32))


@pytest.fixture
def reference() -> Reference:
    plan = GRID.centres()
    height = earth_height(plan[..., 0], plan[..., 1]).astype(np.float32)
    rgb, mask = np.zeros((*GRID.shape, 3), np.uint8), np.ones(GRID.shape, bool)
    return Reference(EnuFrame(47.0, 8.0, 400.0), GRID, rgb, mask, height, np.eye(3), 0.5)


def matches(n: int = 400, seed: int = 0) -> Matches2D:
    """Anywhere inside both, not at pixel centres; which belongs to which does not matter here."""
    rng = np.random.default_rng(seed)
    return Matches2D(rng.uniform(10, [310, 230], (n, 2)), rng.uniform(10, [230, 190], (n, 2)), rng.uniform(size=n))


def lifted(matches_2d: Matches2D, render: Render, reference: Reference) -> Matches3D:
    return lift(matches_2d, render, reference, METRES_PER_LEVEL)


def at_render(*px: tuple[float, float]) -> Matches2D:
    """Matches at these pixels of the render, all to one good place."""
    return Matches2D(np.array(px), np.full((len(px), 2), 100.3), np.ones(len(px)))


def at_reference(*px: tuple[float, float]) -> Matches2D:
    return Matches2D(np.full((len(px), 2), 60.3), np.array(px), np.ones(len(px)))


def with_height(found: Matches3D) -> int:
    return int(np.isfinite(found.xyz_enu[:, 2]).sum())


def test_points_are_exact_between_pixel_centres(render: Render, reference: Reference) -> None:
    wanted = matches()
    found = lifted(wanted, render, reference)
    assert len(found) == 400
    x, y = VIEW.x0 + wanted.px_a[:, 0] * VIEW.pixel, -(VIEW.y0 + wanted.px_a[:, 1] * VIEW.pixel)
    np.testing.assert_allclose(found.xyz_level, np.column_stack([x, y, model_height(x, y)]), atol=1e-6)
    east, north = -60 + 0.5 * wanted.px_b[:, 0], 50 - 0.5 * wanted.px_b[:, 1]
    np.testing.assert_allclose(found.xyz_enu, np.column_stack([east, north, earth_height(east, north)]), atol=1e-5)
    np.testing.assert_array_equal(found.pixels.confidence, wanted.confidence)


def test_without_a_height_of_the_model_nothing_is_left_and_without_the_references_the_place_is(
    render: Render, reference: Reference
) -> None:
    xyz, height = render.xyz.copy(), reference.height.copy()
    xyz[100:140, 100:140] = np.nan
    height[50:80, 50:80] = np.nan
    render, reference = replace(render, xyz=xyz), replace(reference, height=height)
    assert len(lifted(at_render((120, 120), (99.8, 120)), render, reference)) == 0
    in_plan = lifted(at_reference((65, 65), (50.2, 65)), render, reference)
    assert len(in_plan) == 2 and with_height(in_plan) == 0
    np.testing.assert_allclose(in_plan.xyz_enu[:, :2], [[-27.5, 17.5], [-34.9, 17.5]], atol=1e-9)
    # Nothing is lost beyond the holes: the last known pixels are no edge.
    assert len(lifted(at_render((98.4, 120), (120, 142.4)), render, reference)) == 2
    assert with_height(lifted(at_reference((48.4, 65)), render, reference)) == 1


def test_what_is_outside_is_dropped(render: Render, reference: Reference) -> None:
    inside = lifted(at_render((-3, 50), (50, -0.1), (330, 50), (50, 240.1), (5, 5)), render, reference)
    assert len(inside) == 1
    assert len(lifted(at_reference((-3, 50), (50, 200.5), (240.2, 10), (5, 5)), render, reference)) == 1


def test_pixels_of_low_confidence_are_dropped(render: Render, reference: Reference) -> None:
    confidence = render.confidence.copy()
    confidence[:, :160] = 0.29
    found = lifted(matches(), replace(render, confidence=confidence), reference)
    assert 150 < len(found) < 250
    assert (found.pixels.px_a[:, 0] > 159).all()
    options = LiftOptions(min_confidence=0.2)
    assert len(lift(matches(), replace(render, confidence=confidence), reference, METRES_PER_LEVEL, options)) == 400


@pytest.mark.parametrize("side", ["render", "reference"])
def test_edges_are_dropped_and_roofs_kept(render: Render, reference: Reference, side: str) -> None:
    """A box of 6 m height: a match within half of `edge_m` of its wall may be of either height."""
    xyz, height = render.xyz.copy(), reference.height.copy()
    if side == "render":
        xyz[80:160, 80:160, 2] += 6 / METRES_PER_LEVEL
        render, pixel_m, make = replace(render, xyz=xyz), 0.25, at_render
    else:
        height[80:160, 80:160] += 6
        reference, pixel_m, make = replace(reference, height=height), 0.5, at_reference
    near, far = 0.4 / pixel_m, 1.6 / pixel_m
    at_edges = lifted(make((80 - near, 120), (80 + near, 120), (120, 160 - near)), render, reference)
    assert len(at_edges) == (0 if side == "render" else 3) and with_height(at_edges) == 0
    beside = lifted(make((80 - far, 120), (80 + far, 120), (120, 160 - far), (120, 120)), render, reference)
    assert len(beside) == with_height(beside) == 4


def test_steep_ground_is_kept(render: Render, reference: Reference) -> None:
    plan = GRID.centres()
    slope = replace(reference, height=(0.6 * plan[..., 0]).astype(np.float32))
    assert with_height(lifted(matches(), render, slope)) == 400
    cliff = replace(reference, height=(3.0 * plan[..., 0]).astype(np.float32))
    assert with_height(lifted(matches(), render, cliff)) == 0


def test_no_matches(render: Render, reference: Reference) -> None:
    found = lifted(matches(0), render, reference)
    assert len(found) == 0 and found.xyz_enu.shape == (0, 3)


def test_height_step() -> None:
    height = np.zeros((9, 12), np.float32)
    height[:, 6:] = 4
    height[4, 2] = np.nan
    step = height_step(height, 2.0)  # the next odd number of pixels
    assert (step[:, 5:7] == 4).all()
    assert not step[:, :5].any() and not step[:, 7:].any()
    assert np.isinf(height_step(np.full((5, 5), np.nan, np.float32), 3.0)).all()
