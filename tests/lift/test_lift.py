# SPDX-License-Identifier: Apache-2.0
"""Pixels to points: exact pixel centres, and nothing from holes, doubt or height steps."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.geo.frame import EnuFrame
from skymoor.geo.grid import Grid
from skymoor.lift import LiftOptions, lift
from skymoor.lift.lift import height_step
from skymoor.types import Matches2D, Reference, Render, View

DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
PIXEL, METRES = 0.005, 60.0  # level units per pixel, metres per level unit


def sloping_render(shape: tuple[int, int] = (80, 100)) -> Render:
    """z rises by 0.1 per unit of x: a plane, on which bilinear sampling is exact."""
    h, w = shape
    u, v = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    x, y = u * PIXEL, -v * PIXEL
    xyz = np.stack([x, y, 0.1 * x], axis=-1).astype(np.float32)
    return Render(View(DOWN, 0, 0, PIXEL, shape), np.zeros((h, w, 3), np.uint8), xyz, np.ones(shape, np.float32))


def sloping_reference(shape: tuple[int, int] = (120, 120)) -> Reference:
    """up rises by 0.02 per metre east."""
    grid = Grid(-30.0, 40.0, 0.5, shape)
    east = -30 + 0.5 * (np.arange(shape[1]) + 0.5)
    height = np.broadcast_to(0.02 * east, shape).astype(np.float32)
    rgb = np.zeros((*shape, 3), np.uint8)
    return Reference(EnuFrame(50, 8, 100), grid, rgb, np.ones(shape, bool), height, np.eye(3), 0.5)


def matches(rng: np.random.Generator, n: int = 300) -> Matches2D:
    return Matches2D(rng.uniform([5, 5], [95, 75], (n, 2)), rng.uniform(5, 115, (n, 2)), np.ones(n))


def test_points_are_exact_on_planes(rng: np.random.Generator) -> None:
    found = lift(matches(rng), sloping_render(), sloping_reference(), METRES)
    assert len(found) == 300
    px_a, px_b = found.pixels.px_a, found.pixels.px_b
    assert found.xyz_level == pytest.approx(
        np.column_stack([px_a[:, 0] * PIXEL, -px_a[:, 1] * PIXEL, 0.1 * px_a[:, 0] * PIXEL]), abs=1e-6
    )
    east, north = -30 + 0.5 * px_b[:, 0], 40 - 0.5 * px_b[:, 1]
    assert found.xyz_enu == pytest.approx(np.column_stack([east, north, 0.02 * east]), abs=1e-5)


def test_doubt_and_holes_are_left_out(rng: np.random.Generator) -> None:
    render, reference = sloping_render(), sloping_reference()
    render.confidence[:, :50] = 0.1
    reference.height[60:] = np.nan
    given = matches(rng)
    found = lift(given, render, reference, METRES).pixels
    good = (given.px_a[:, 0] > 52) & (given.px_b[:, 1] < 56)
    assert found.px_a[:, 0].min() > 48 and found.px_b[:, 1].max() < 60
    assert good.sum() <= len(found) < 0.5 * len(given)


@pytest.mark.parametrize("side", ["render", "reference"])
def test_eaves_are_left_out(side: str, rng: np.random.Generator) -> None:
    render, reference = sloping_render(), sloping_reference()
    if side == "render":
        render.xyz[:, 50:, 2] += 4 / METRES
    else:
        reference.height[:, 60:] += 4
    found = lift(matches(rng, 2000), render, reference, METRES).pixels
    place, step, reach = (found.px_a[:, 0], 50, 2) if side == "render" else (found.px_b[:, 0], 60, 1)
    assert np.abs(place - step).min() > reach
    assert len(found) > 1500
    everything = lift(matches(rng, 2000), render, reference, METRES, LiftOptions(max_step_slope=9)).pixels
    assert len(everything) > len(found)


def test_height_step_is_the_range_within_the_window() -> None:
    height = np.zeros((20, 20), np.float32)
    height[:, 10:] = 3
    height[5, 5] = np.nan
    step = height_step(height, 3)
    assert step[10, 9] == step[10, 10] == 3
    assert step[10, 7] == step[5, 5] == 0
    assert np.isinf(height_step(np.full((9, 9), np.nan, np.float32), 3)).all()
