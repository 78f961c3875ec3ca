# SPDX-License-Identifier: Apache-2.0
"""The stages of a ground component, on boxes with exact depth: each method places it, and all that hangs on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skymoor import pipeline_ground
from skymoor.geometry.similarity import Similarity
from skymoor.match import MatcherOptions
from skymoor.pipeline import Job, Placed
from skymoor.pipeline_ground import register_ground_sets
from skymoor.settings import GroundSetOptions, Options
from skymoor.store import Store
from skymoor.tile_search import CascadeOptions, ConsensusOptions
from skymoor.types import Component, DepthMap, Registration, Render, View, no_progress
from tile_world import PICTURES, TileOracle, TileWorld, floated

CONSENSUS = ConsensusOptions(pictures=PICTURES)


@dataclass(frozen=True)
class WorldModel:
    """The boxes as a model whose renders are those that the oracle knows."""

    world: TileWorld
    pixel: float = 0.33

    @cached_property
    def surface_points(self) -> np.ndarray:
        return np.concatenate([render.xyz[np.isfinite(render.xyz[..., 0])] for render in self.world.renders])

    def render(self, view: View, *, progress: object = None) -> Render:
        index = int(
            np.argmin([np.abs(r.view.view_from_level - view.view_from_level).sum() for r in self.world.renders])
        )
        return self.world.renders[index]


def component_of(maps: Sequence[DepthMap]) -> Component:
    none = np.zeros(0, np.intp)
    points, colours = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    return Component(tuple(m.camera for m in maps), points, colours, none, none, np.zeros((0, 2)), 0.5)


@pytest.fixture
def stubbed(monkeypatch: pytest.MonkeyPatch) -> tuple[list[DepthMap], Similarity, TileWorld]:
    """A walk whose reconstruction, gravity and depth are known."""
    world = TileWorld()
    maps, enu_from_level = floated(world.walk(), tilt_deg=0.0)

    def stage(name: str, *args: Any) -> list[DepthMap]:
        job: Job = args[2]
        return job.store.stage(f"{name}.depths", lambda: maps)

    monkeypatch.setattr(pipeline_ground, "reconstruct_set", lambda *_: [component_of(maps), component_of(maps[:2])])
    monkeypatch.setattr(pipeline_ground, "estimate_ground_gravity", lambda *_: None)
    monkeypatch.setattr(pipeline_ground, "level_from_gravity", lambda *_: Similarity.identity())
    monkeypatch.setattr(pipeline_ground, "densify_component", stage)
    return maps, enu_from_level, world


def airborne_of(world: TileWorld, store: Store) -> Placed:
    store.stage("air.depths", lambda: [])
    for stage in ("model", "nadir", "register"):
        store.stage(f"air.{stage}", lambda: None)
    here = Registration(True, "", Similarity.identity())
    model = WorldModel(world)
    base = Placed("air", component_of(world.walk()), Similarity.identity(), here, depths=[])
    return replace(base, model=model, render=world.renders[0])


@pytest.mark.parametrize("method", ["cascade", "exhaustive"])
def test_tiles_place_both_components(
    method: Any, tmp_path: Path, stubbed: tuple[list[DepthMap], Similarity, TileWorld]
) -> None:
    maps, enu_from_level, world = stubbed
    oracle: Any = TileOracle(world.airborne, world.walk())
    ground = GroundSetOptions(
        method=method,
        matcher=MatcherOptions(structural=oracle),
        cascade=CascadeOptions(consensus=CONSENSUS),
        exhaustive=CONSENSUS,
    )
    with Store.open(tmp_path) as store:
        base = airborne_of(world, store)
        job = Job(None, None, Options(ground=ground), store, 0, lambda _: no_progress, "ground0", "air.model")  # type: ignore[arg-type]
        ((first, second),) = register_ground_sets([job], [base])
    for item in (first, second):
        assert item.registration.registered, item.registration.reason
        assert item.registration.enu_from_level is not None
        assert item.base is base
        centres = np.array([m.camera.centre for m in maps])
        gaps = item.registration.enu_from_level.apply(centres) - enu_from_level.apply(centres)
        assert np.linalg.norm(gaps, axis=1).max() < 0.2
        assert item.registration.diagnostics["pairs"] <= item.registration.diagnostics["pairs_in_all"]


def test_without_an_airborne_component_all_are_refused(
    tmp_path: Path, stubbed: tuple[list[DepthMap], Similarity, TileWorld]
) -> None:
    with Store.open(tmp_path) as store:
        job = Job(None, None, Options(), store, 0, lambda _: no_progress, "ground0", "photos")  # type: ignore[arg-type]
        (found,) = register_ground_sets([job], [])
    assert [item.registration.registered for item in found] == [False, False]
    assert "no airborne component is registered" in found[0].registration.reason
    assert register_ground_sets([], []) == []
