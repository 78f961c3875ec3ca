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

from skymoor.densify import MetricDepthOptions
from skymoor.geometry import Similarity
from skymoor.ground.tiles import CascadeOptions, ConsensusOptions
from skymoor.match import MatcherOptions
from skymoor.pipeline import ground as pipeline_ground
from skymoor.pipeline.airborne import ComponentResult, Job
from skymoor.pipeline.ground import register_ground_sets
from skymoor.pipeline.options import GroundSetOptions, Options
from skymoor.store import Store
from skymoor.types import Component, DepthMap, Registration, Render, View, no_progress
from support.tile_world import PICTURES, TileOracle, TileWorld, floated

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
    monkeypatch.setattr(pipeline_ground, "estimate_ground_gravity", lambda *_, ground: None)
    monkeypatch.setattr(pipeline_ground, "level_from_gravity", lambda *_: Similarity.identity())
    monkeypatch.setattr(pipeline_ground, "densify_component", stage)
    return maps, enu_from_level, world


def airborne_of(world: TileWorld, store: Store) -> ComponentResult:
    store.stage("air.depths", lambda: [])
    for stage in ("model", "nadir", "register"):
        store.stage(f"air.{stage}", lambda: None)
    here = Registration(True, "", Similarity.identity())
    model = WorldModel(world)
    base = ComponentResult("air", component_of(world.walk()), Similarity.identity(), here, depths=[])
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
        (best,) = item.hypotheses
        middle = enu_from_level.apply(np.median([camera.centre for camera in item.component.cameras], axis=0)[None])[0]
        np.testing.assert_allclose([best.east, best.north], middle[:2], atol=0.2)
        assert best.metres_per_unit == pytest.approx(enu_from_level.scale, rel=0.01)
        clockwise = -np.degrees(np.arctan2(enu_from_level.rotation[1, 0], enu_from_level.rotation[0, 0]))
        assert abs((best.azimuth_deg - clockwise + 180) % 360 - 180) < 1
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


def test_an_error_in_one_component_refuses_that_one(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    stubbed: tuple[list[DepthMap], Similarity, TileWorld],
) -> None:
    maps, _, world = stubbed

    def breaks(found: Sequence[DepthMap], *_: Any, **__: Any) -> Registration:
        if len(found) == len(maps):
            raise np.linalg.LinAlgError("Singular matrix")
        return Registration(True, "", Similarity.identity(), diagnostics={"score": 30.0})

    monkeypatch.setattr(pipeline_ground, "exhaustive", breaks)
    ground = GroundSetOptions(method="exhaustive")
    with Store.open(tmp_path) as store:
        job = Job(None, None, Options(ground=ground), store, 0, lambda _: no_progress, "ground0", "air.model")  # type: ignore[arg-type]
        world_base = airborne_of(world, store)
        monkeypatch.setattr(
            pipeline_ground, "densify_component", lambda name, level, *_: stored(name, level, maps, job)
        )
        ((broken, whole),) = register_ground_sets([job], [world_base])
    assert not broken.registration.registered
    assert broken.registration.reason == "internal error (LinAlgError: Singular matrix); run.log has the traceback"
    assert whole.registration.registered
    assert "Traceback" in caplog.text and "ground0-0: failed unexpectedly" in caplog.text


def stored(name: str, level: Component, maps: Sequence[DepthMap], job: Job) -> list[DepthMap]:
    own = list(maps[: len(level.cameras)])
    return job.store.stage(f"{name}.depths", lambda: own)


@dataclass(frozen=True)
class Metres:
    """Says the true distances of the world's walk, times a factor."""

    factor: float
    metres_per_unit: float

    def __call__(self, image: np.ndarray, focal_px: float) -> np.ndarray:
        assert focal_px == 76.0
        depths = {m.rgb.tobytes(): m.depth for m in floated(TileWorld().walk(), tilt_deg=0.0)[0]}
        return np.asarray(self.factor * self.metres_per_unit * depths[image.tobytes()], np.float32)


@pytest.mark.parametrize(("factor", "narrowed"), [(1.1, True), (1e4, False)])
def test_metres_of_single_photos_narrow_the_search(
    factor: float,
    narrowed: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    stubbed: tuple[list[DepthMap], Similarity, TileWorld],
) -> None:
    """A tenth too large is within what such networks may err; what contradicts all that was to be searched is left."""
    _, enu_from_level, world = stubbed
    searched: list[ConsensusOptions] = []

    def spy(maps: Any, renders: Any, matcher: Any, options: ConsensusOptions, **_: Any) -> Registration:
        searched.append(options)
        return Registration(False, "not searched", None)

    monkeypatch.setattr(pipeline_ground, "exhaustive", spy)
    metric: Any = MetricDepthOptions(kind="network", network=Metres(factor, enu_from_level.scale))  # type: ignore[arg-type]
    consensus = ConsensusOptions(min_scale=0.01, max_scale=100.0)
    ground = GroundSetOptions(method="exhaustive", metric=metric, exhaustive=consensus)
    with Store.open(tmp_path) as store:
        job = Job(None, None, Options(ground=ground), store, 0, lambda _: no_progress, "ground0", "air.model")  # type: ignore[arg-type]
        ((first, second),) = register_ground_sets([job], [airborne_of(world, store)])
    assert first.metric is not None
    assert first.metric.metres_per_unit == pytest.approx(factor * enu_from_level.scale, rel=0.02)
    assert second.metric is not None
    low, high = searched[0].min_scale, searched[0].max_scale
    if narrowed:
        assert 0.5 * enu_from_level.scale < low < enu_from_level.scale < high < 2.0 * enu_from_level.scale
        width_m = np.median([np.nanmedian(m.depth) for m in first.depths]) * 96 / 76 * factor * enu_from_level.scale
        assert searched[0].pictures.tile_px == pytest.approx(max(150, width_m / 0.33), rel=0.1)
    else:
        assert (low, high) == (0.01, 100.0)
        assert searched[0].pictures.tile_px == 900
