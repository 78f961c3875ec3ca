# SPDX-License-Identifier: Apache-2.0
"""The reference shows the scene where it stands, off by exactly the bias that was put in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from pyproj import Transformer

from skymoor.geo import ce90_m, le90_m
from skymoor.simulate.mesh import stream
from skymoor.simulate.plan import PLACES_DEG, Season, dates_of, place_of
from skymoor.simulate.satellite import (
    ACCURACY_M,
    MapSheet,
    SimulatedReference,
    _blunders,
    _in_leaf,
    covariance_of,
    draw_bias,
    make_reference,
)
from skymoor.simulate.world import World

Array = NDArray[np.float64]
MakeWorld = Callable[..., World]

BIAS_M = np.array([1.6, -2.3, 1.1])


def px_of(world: World, sheet: MapSheet, plan: Array) -> Array:
    """Pixels (n, 2), centre of the first at (0.5, 0.5), that show plan positions (n, 2): straight through PROJ."""
    lla = place_of(world.options).lla_from_enu(np.column_stack([plan, np.zeros(len(plan))]))
    x, y = Transformer.from_crs("EPSG:4326", sheet.crs, always_xy=True).transform(lla[:, 1], lla[:, 0])
    return np.column_stack([x - sheet.easting_m, sheet.northing_m - y]) / sheet.pixel_m


@pytest.fixture(scope="module")
def reference(world: World) -> SimulatedReference:
    return reference_of(world, BIAS_M)


def reference_of(world: World, bias_m: Array, seed: int = 5) -> SimulatedReference:
    return make_reference(world, world.scene(dates_of(world.options).satellite), bias_m, stream(seed, "reference"))


@pytest.mark.parametrize("preset", sorted(ACCURACY_M))
def test_the_covariance_has_the_paper_s_accuracy_and_ties_the_axes(make_world: MakeWorld, preset: str) -> None:
    for seed in range(4):
        covariance = covariance_of(make_world(preset=preset, seed=seed).options)
        assert (ce90_m(covariance), le90_m(covariance)) == pytest.approx(ACCURACY_M[preset], rel=1e-6)
        assert np.linalg.eigvalsh(covariance)[0] > 0 and np.abs(np.tril(covariance, -1)).max() > 0.01
    stated = covariance_of(make_world(preset=preset, ce90_m=0.5, le90_m=0.9).options)
    assert (ce90_m(stated), le90_m(stated)) == pytest.approx((0.5, 0.9), rel=1e-6)


def test_biases_are_drawn_from_their_covariance(world: World, rng: np.random.Generator) -> None:
    covariance = covariance_of(world.options)
    biases = np.array([draw_bias(covariance, rng) for _ in range(6000)])
    scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    np.testing.assert_allclose(np.cov(biases.T) / scale, covariance / scale, atol=0.06)
    assert np.mean(np.hypot(*biases[:, :2].T) < ce90_m(covariance)) == pytest.approx(0.9, abs=0.02)
    assert np.mean(np.abs(biases[:, 2]) < le90_m(covariance)) == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize("seed", range(6))
def test_pixels_know_their_place_through_any_zone(make_world: MakeWorld, seed: int) -> None:
    options = make_world(seed=seed).options
    frame = place_of(options)
    zone = int((frame.lon_deg + 180) // 6) + 1
    crs = f"EPSG:{(32600 if frame.lat_deg > 0 else 32700) + zone}"
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(frame.lon_deg, frame.lat_deg)
    sheet = MapSheet(crs, round(x) - 150, round(y) + 150, 2.0, 150)
    north_up_m = 0.0
    seen = np.zeros((150, 150), int)
    for rows, columns, plan in sheet.tiles(frame, 1):
        seen[rows, columns] += 1
        u, v = np.meshgrid(np.arange(columns.start, columns.stop) + 0.5, np.arange(rows.start, rows.stop) + 0.5)
        exact = px_of(make_world(seed=seed), sheet, plan.reshape(-1, 2))
        np.testing.assert_allclose(exact, np.column_stack([u.ravel(), v.ravel()]), atol=1e-4)
        naive = np.stack([sheet.easting_m + 2 * u - x, sheet.northing_m - 2 * v - y], axis=-1)
        north_up_m = max(north_up_m, float(np.linalg.norm(naive - plan, axis=2).max()))
    assert (seen == 1).all()
    assert north_up_m > 0.05  # the grid's turn and scale are there


def test_zones_and_hemispheres(make_world: MakeWorld) -> None:
    found = set()
    for seed in range(12):
        world = make_world(seed=seed, reference_width_m=24.0, ortho_pixel_m=6.0, dsm_pixel_m=6.0)
        made = reference_of(world, np.zeros(3))
        area = Transformer.from_crs("EPSG:4326", made.dsm_sheet.crs, always_xy=True)
        frame = place_of(world.options)
        easting, northing = area.transform(frame.lon_deg, frame.lat_deg)
        assert abs(easting - 500000) < 340000  # a zone is no wider
        assert northing > 0
        found.add(made.dsm_sheet.crs[:8])
    assert found == {"EPSG:326", "EPSG:327"} and any(lat < 0 for lat, _ in PLACES_DEG)


def test_heights_are_the_scene_s_plus_the_bias_and_the_noise(world: World, reference: SimulatedReference) -> None:
    frame = place_of(world.options)
    plan = np.random.default_rng(1).uniform(-40, 40, (4000, 2))
    far = np.ones(len(plan), bool)
    for building in (*world.plan.buildings, *world.plan.distractors):
        outline = building.outline_enu.astype(np.float32)
        gap = np.array([cv2.pointPolygonTest(outline, (float(e), float(n)), True) for e, n in plan])
        far &= np.abs(gap) > 5
    plan = plan[far & (np.linalg.norm(plan - world.plan.trees[0, :2], axis=1) > 8)]
    scene = world.scene(dates_of(world.options).satellite)
    above = np.column_stack([plan, np.full(len(plan), 100.0)])
    true = above - [0, 0, 1] * scene.cast(above, np.tile([0.0, 0.0, -1.0], (len(plan), 1))).distance[:, None]
    shown = true + BIAS_M
    px = px_of(world, reference.dsm_sheet, shown[:, :2]).astype(int)
    error = reference.dsm[px[:, 1], px[:, 0]] - frame.lla_from_enu(shown)[:, 2]
    error = error[np.isfinite(error)]
    assert len(error) > 1000
    assert np.median(error) == pytest.approx(0.0, abs=0.05)
    assert 0.15 < 1.4826 * np.median(np.abs(error - np.median(error))) < 0.35
    assert np.mean(np.abs(error) > 1.5) < 0.02


def test_few_heights_are_blunders(rng: np.random.Generator) -> None:
    wrong = np.abs(_blunders(rng, (800, 800), 0.5))
    assert 0.0008 < np.mean(wrong > 1.0) < 0.0025
    assert 4 < wrong.max() < 8.5


def test_buildings_stand_off_by_the_bias_in_the_dsm(world: World, reference: SimulatedReference) -> None:
    sheet, errors = reference.dsm_sheet, []
    centres = np.concatenate([plan.reshape(-1, 2) for _, _, plan in sheet.tiles(place_of(world.options), 1)])
    heights = np.concatenate([reference.dsm[r, c].ravel() for r, c, _ in sheet.tiles(place_of(world.options), 1)])
    for building in world.plan.buildings:
        middle = np.array([building.east, building.north])
        near = np.linalg.norm(centres - middle, axis=1) < 16
        roof = near & (heights > np.nanmedian(heights) + 2.2)
        errors.append(centres[roof].mean(axis=0) - middle)
    np.testing.assert_allclose(np.mean(errors, axis=0), BIAS_M[:2], atol=0.35)


def test_the_orthophoto_is_off_by_the_bias(world: World, reference: SimulatedReference) -> None:
    sheet = reference.ortho_sheet
    scene = world.scene(dates_of(world.options).satellite)
    exact = np.zeros((sheet.side, sheet.side), np.float32)
    for rows, columns, plan in sheet.tiles(place_of(world.options), 1):
        above = np.column_stack([plan.reshape(-1, 2), np.full(plan.size // 2, 100.0)])
        light = scene.radiance(above, np.tile([0.0, 0.0, -1.0], (len(above), 1)), pixel_m=sheet.pixel_m)
        exact[rows, columns] = light.mean(axis=1).reshape(plan.shape[:2])
    shown = reference.ortho.astype(np.float32).mean(axis=2)
    window = cv2.createHanningWindow((sheet.side, sheet.side), cv2.CV_32F)
    (right, down), response = cv2.phaseCorrelate(exact - exact.mean(), (shown - shown.mean()) / 255, window)
    assert response > 0.1
    assert (right, -down) == pytest.approx(tuple(BIAS_M[:2]), abs=0.35)


def test_the_orthophoto_looks_like_one(reference: SimulatedReference) -> None:
    grey = reference.ortho.astype(float)
    assert 15 < grey.std() < 80 and 40 < grey.mean() < 200
    assert (reference.ortho == 255).mean() < 0.02 and (reference.ortho == 0).mean() < 0.02


def test_seen_from_the_side_roofs_lean_and_the_ground_does_not(make_world: MakeWorld) -> None:
    straight, leaning = (
        reference_of(make_world(off_nadir_deg=lean, ortho_pixel_m=0.5), np.zeros(3)) for lean in (0.0, 25.0)
    )
    world, sheet = make_world(ortho_pixel_m=0.5), straight.ortho_sheet
    a, b = (cv2.cvtColor(made.ortho, cv2.COLOR_RGB2GRAY) for made in (straight, leaning))
    shifts = []
    for building in world.plan.buildings[:2]:
        u, v = px_of(world, sheet, np.array([[building.east, building.north]]))[0].astype(int)
        score = cv2.matchTemplate(b[v - 30 : v + 30, u - 30 : u + 30], a[v - 7 : v + 7, u - 7 : u + 7], 5)
        _, best, _, (x, y) = cv2.minMaxLoc(score)
        assert best > 0.7
        shifts.append(0.5 * np.array([x - 23, 23 - y]))
        assert np.linalg.norm(shifts[-1]) == pytest.approx(np.tan(np.radians(25)) * building.walls_m, abs=0.8)
    assert shifts[0] @ shifts[1] > 0.95 * np.linalg.norm(shifts[0]) * np.linalg.norm(shifts[1])
    u, v = px_of(world, sheet, np.array([[-2.0, -14.0]]))[0].astype(int)
    score = cv2.matchTemplate(b[v - 20 : v + 20, u - 20 : u + 20], a[v - 7 : v + 7, u - 7 : u + 7], 5)
    assert cv2.minMaxLoc(score)[3] == (13, 13)


def test_large_trees_are_in_leaf_in_the_surface_model(make_world: MakeWorld) -> None:
    cases: tuple[tuple[str, Season], ...] = (("old-houses", "summer"), ("office-park", "winter"))
    for preset, shown in cases:
        worlds = (make_world(preset=preset, seed=seed) for seed in range(20))
        world = next(w for w in worlds if dates_of(w.options).satellite.season == "winter")
        date = dates_of(world.options).satellite
        assert _in_leaf(world, world.scene(date)) is world.scene(replace(date, season=shown))


def test_holes_lie_in_the_shadow(world: World, reference: SimulatedReference) -> None:
    hole = ~np.isfinite(reference.dsm)
    assert 0.0005 < hole.mean() < 0.08
    scene = world.scene(dates_of(world.options).satellite)
    dark = np.zeros_like(hole)
    for rows, columns, plan in reference.dsm_sheet.tiles(place_of(world.options), 1):
        flat = plan.reshape(-1, 2) - BIAS_M[:2]
        above = np.column_stack([flat, np.full(len(flat), 100.0)])
        up = above[:, 2] - scene.cast(above, np.tile([0.0, 0.0, -1.0], (len(flat), 1))).distance
        rays = np.tile(scene.sun, (len(flat), 1))
        shaded = np.isfinite(scene.cast(np.column_stack([flat, up + 0.2]), rays).distance)
        dark[rows, columns] = shaded.reshape(plan.shape[:2])
    assert dark[hole].mean() > 0.7 and dark.mean() < 0.4


def test_the_files_say_what_is_in_them(tmp_path: Path, reference: SimulatedReference) -> None:
    reference.write_ortho(tmp_path / "ortho.tif")
    reference.write_dsm(tmp_path / "dsm.tif")
    with rasterio.open(tmp_path / "ortho.tif") as file:
        assert file.count == 3 and file.dtypes[0] == "uint8" and file.transform == reference.ortho_sheet.transform
        np.testing.assert_array_equal(file.read().transpose(1, 2, 0), reference.ortho)
    with rasterio.open(tmp_path / "dsm.tif") as file:
        assert file.crs.to_string() == reference.dsm_sheet.crs and file.nodata is not None
        heights = file.read(1, masked=True)
        np.testing.assert_array_equal(heights.mask, ~np.isfinite(reference.dsm))
        np.testing.assert_array_equal(heights.filled(np.nan), reference.dsm)


def test_the_same_seed_makes_the_same_reference(world: World, reference: SimulatedReference) -> None:
    again, other = reference_of(world, BIAS_M), reference_of(world, BIAS_M, seed=6)
    np.testing.assert_array_equal(again.ortho, reference.ortho)
    np.testing.assert_array_equal(again.dsm, reference.dsm)
    assert (other.ortho != reference.ortho).mean() > 0.5
