# SPDX-License-Identifier: Apache-2.0
"""A known similarity is recovered from tile matches, exhaustively and by the cascade; other sites are refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.ground.tiles import CascadeOptions, ConsensusOptions, cascade, exhaustive
from skymoor.types import DepthMap, Registration
from support.tile_world import PICTURES, TileOracle, TileWorld, bent, floated

CONSENSUS = ConsensusOptions(pictures=PICTURES)
QUICK = CascadeOptions(consensus=replace(CONSENSUS, min_scale=1.1, max_scale=2.3))


@pytest.fixture(scope="module")
def world() -> TileWorld:
    return TileWorld()


@pytest.fixture(scope="module")
def oracle(world: TileWorld) -> TileOracle:
    """Of the walk; 30 % of the wrong pairs are confidently wrong."""
    return TileOracle(world.airborne, world.walk(), false_share=0.3)


@pytest.fixture(scope="module")
def walk(world: TileWorld) -> tuple[list[DepthMap], Similarity]:
    return floated(world.walk())


@pytest.fixture(scope="module")
def by_all(world: TileWorld, oracle: TileOracle, walk: tuple[list[DepthMap], Similarity]) -> Registration:
    return exhaustive(walk[0], world.renders, oracle, CONSENSUS, rng=np.random.default_rng(0))


def camera_gaps_m(found: Registration, maps: list[DepthMap], enu_from_level: Similarity) -> np.ndarray:
    assert found.enu_from_level is not None
    centres = np.array([depth_map.camera.centre for depth_map in maps])
    return np.linalg.norm(found.enu_from_level.apply(centres) - enu_from_level.apply(centres), axis=1)


def test_the_exhaustive_search_finds_the_registration(
    by_all: Registration, walk: tuple[list[DepthMap], Similarity], world: TileWorld
) -> None:
    maps, enu_from_level = walk
    assert by_all.registered, by_all.reason
    assert camera_gaps_m(by_all, maps, enu_from_level).max() < 0.1
    assert by_all.enu_from_level is not None
    assert abs(by_all.enu_from_level.scale / enu_from_level.scale - 1) < 0.005
    # The tilt and the noise that were put in come out: no more, and no less.
    assert 0.4 < by_all.tilt_deg < 0.8
    assert 0.02 < by_all.rmse_m < 0.2
    assert by_all.diagnostics["pairs"] == len(maps) * len(world.airborne.tiles)
    assert by_all.diagnostics["photos_agree"] == len(maps)
    assert 0.2 < by_all.inlier_ratio < 0.8  # some of the best tiles are wrong, and some matches of the right ones


def test_wrong_tiles_do_not_win(by_all: Registration) -> None:
    # Without them there would be no second hypothesis.
    assert 50 < by_all.diagnostics["second_score"] < 0.2 * by_all.diagnostics["score"]


def test_the_cascade_gives_the_same_result_for_few_pairs(
    by_all: Registration, walk: tuple[list[DepthMap], Similarity], world: TileWorld, oracle: TileOracle
) -> None:
    maps, enu_from_level = walk
    for seed in range(2):
        counted = replace(oracle, calls=[])
        found = cascade(maps, world.renders, counted, QUICK, rng=np.random.default_rng(seed))
        assert found.registered, found.reason
        assert by_all.enu_from_level is not None
        assert camera_gaps_m(found, maps, by_all.enu_from_level).max() < 0.1
        assert camera_gaps_m(found, maps, enu_from_level).max() < 0.1
        pairs = found.diagnostics["pairs"]
        assert pairs == len(counted.calls) == len(set(counted.calls))
        assert len(maps) < pairs <= found.diagnostics["pairs_in_all"] / 4
        assert found.diagnostics["pairs_in_all"] == by_all.diagnostics["pairs"]


def test_the_same_state_gives_the_same_result(
    walk: tuple[list[DepthMap], Similarity], world: TileWorld, oracle: TileOracle
) -> None:
    a, b = (cascade(walk[0], world.renders, oracle, QUICK, rng=np.random.default_rng(2)) for _ in range(2))
    assert a.enu_from_level is not None and b.enu_from_level is not None
    # Open3D's threads sum in any order.
    np.testing.assert_allclose(a.enu_from_level.matrix(), b.enu_from_level.matrix(), atol=1e-9)
    assert a.diagnostics == pytest.approx(b.diagnostics, rel=1e-6)


def test_what_no_tile_shows_is_refused(
    walk: tuple[list[DepthMap], Similarity], world: TileWorld, oracle: TileOracle
) -> None:
    blind = replace(oracle, blind=True, calls=[])
    for found in (
        exhaustive(walk[0], world.renders, blind, CONSENSUS, rng=np.random.default_rng(0)),
        cascade(walk[0], world.renders, blind, QUICK, rng=np.random.default_rng(0)),
    ):
        assert not found.registered
        assert found.reason
    # It gives up at its share.
    assert found.diagnostics["pairs"] == np.ceil(QUICK.max_share * found.diagnostics["pairs_in_all"])


def test_a_matcher_without_matches_is_refused(walk: tuple[list[DepthMap], Similarity], world: TileWorld) -> None:
    silent = TileOracle(world.airborne, world.walk(), blind=True)
    found = cascade(walk[0], world.renders, silent, replace(QUICK, max_share=0.02), rng=np.random.default_rng(0))
    assert not found.registered
    assert "yields a transform" in found.reason
    assert found.enu_from_level is None


def test_the_budget_is_kept(walk: tuple[list[DepthMap], Similarity], world: TileWorld, oracle: TileOracle) -> None:
    seconds = count()
    blind = replace(oracle, blind=True, calls=[])
    options = replace(QUICK, budget_s=40.0)
    found = cascade(
        walk[0], world.renders, blind, options, rng=np.random.default_rng(0), clock=lambda: float(next(seconds))
    )
    # The clock goes on by a second whenever it is looked at, which is at least once per pair.
    assert 10 < len(blind.calls) <= 40
    assert found.diagnostics["out_of_time"] == 1
    assert not found.registered


def test_one_bent_camera_does_not_spoil_the_others(world: TileWorld, oracle: TileOracle) -> None:
    maps, enu_from_level = floated(bent(world.walk(), 2, 1.5))
    found = cascade(maps, world.renders, oracle, QUICK, rng=np.random.default_rng(0))
    assert found.registered, found.reason
    assert camera_gaps_m(found, maps, enu_from_level).max() < 0.15
    # The bent one is left out: the others agree.
    assert 4 <= found.diagnostics["photos_agree"] <= 5


def test_two_photos_are_no_consensus(world: TileWorld, oracle: TileOracle) -> None:
    maps, _ = floated(world.walk()[:2])
    found = cascade(maps, world.renders, oracle, QUICK, rng=np.random.default_rng(0))
    assert not found.registered
    assert "2 photos agree" in found.reason


def test_photos_without_depth_are_an_error(world: TileWorld, oracle: TileOracle) -> None:
    maps, _ = floated(world.walk()[:2])
    blind = [replace(m, depth=np.full_like(m.depth, np.nan)) for m in maps]
    with pytest.raises(DegenerateGeometry, match="no ground photo"):
        cascade(blind, world.renders, oracle, QUICK, rng=np.random.default_rng(0))
