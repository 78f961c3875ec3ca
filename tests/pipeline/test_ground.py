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

from skymoor.geometry import Similarity
from skymoor.ground.tiles import ConsensusOptions
from skymoor.pipeline import ground as pipeline_ground
from skymoor.pipeline.engines import Engines
from skymoor.pipeline.ground import register_ground_sets
from skymoor.pipeline.job import ComponentResult, Job
from skymoor.pipeline.options import GroundChoices, Options
from skymoor.pipeline.stopping import StoppedAfter
from skymoor.store import Store
from skymoor.types import Component, DepthMap, Photos, Registration, Render, View, no_progress
from support.tile_world import PICTURES, TileOracle, TileWorld, floated

CONSENSUS = ConsensusOptions(pictures=PICTURES)


@dataclass(frozen=True)
class WorldModel:
    """The boxes as a model whose renders are those that the oracle knows."""

    world: TileWorld
    pixel: float = 0.33

    def cache_key(self) -> str:
        return "boxes"

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

    monkeypatch.setattr(pipeline_ground, "reconstruct_set", lambda *_: [component_of(maps), component_of(maps[:2])])
    monkeypatch.setattr(pipeline_ground, "estimate_ground_gravity", lambda *_, ground: None)
    monkeypatch.setattr(pipeline_ground, "level_from_gravity", lambda *_: Similarity.identity())
    monkeypatch.setattr(pipeline_ground, "densify_component", lambda *_: maps)
    monkeypatch.setattr(pipeline_ground, "CASCADE", CONSENSUS)
    monkeypatch.setattr(pipeline_ground, "EXHAUSTIVE", CONSENSUS)
    return maps, enu_from_level, world


def ground_job(store: Store, options: Options | None = None) -> Job:
    nothing: Any = None
    return Job(nothing, nothing, options or Options(), store, 0, lambda _: no_progress, "ground0")


def airborne_of(world: TileWorld) -> ComponentResult:
    here = Registration(True, "", Similarity.identity())
    model = WorldModel(world)
    base = ComponentResult("air", component_of(world.walk()), Similarity.identity(), here, depths=[])
    return replace(base, model=model, render=world.renders[0])


def photos_of(world: TileWorld) -> Photos:
    pictures = {one.camera.image: one.rgb for one in world.walk()}
    sizes = tuple((rgb.shape[1], rgb.shape[0]) for rgb in pictures.values())
    return Photos(tuple(pictures), sizes, pictures.__getitem__, content="boxes")


@pytest.mark.parametrize("method", ["cascade", "exhaustive"])
def test_tiles_place_both_components(
    method: Any, tmp_path: Path, stubbed: tuple[list[DepthMap], Similarity, TileWorld]
) -> None:
    maps, enu_from_level, world = stubbed
    oracle: Any = TileOracle(world.airborne, world.walk())
    options = Options(engines=Engines(structural=oracle), ground=GroundChoices(method=method))
    base = airborne_of(world)
    with Store.open(tmp_path) as store:
        ((first, second),) = register_ground_sets([ground_job(store, options)], [base], photos_of(world))
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
        (found,) = register_ground_sets([ground_job(store)], [], photos_of(stubbed[2]))
    assert [item.registration.registered for item in found] == [False, False]
    assert "no registered airborne component" in found[0].registration.reason
    assert register_ground_sets([], [], photos_of(stubbed[2])) == []


@pytest.mark.parametrize(("step", "measured"), [("reconstruct", 0), ("depth", 2), ("search", 2)])
def test_a_run_that_stops_comes_as_far_as_it_can_without_an_airborne_one(
    step: Any,
    measured: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    stubbed: tuple[list[DepthMap], Similarity, TileWorld],
) -> None:
    maps, _, world = stubbed
    densified: list[str] = []

    def densify(name: str, _: Component, job: Job, *__: object) -> list[DepthMap]:
        densified.append(name)
        job.end_of("depth")
        return maps

    monkeypatch.setattr(pipeline_ground, "densify_component", densify)
    with Store.open(tmp_path) as store:
        (found,) = register_ground_sets([replace(ground_job(store), stop_after=step)], [], photos_of(world))
    assert [item.registration.reason for item in found] == [str(StoppedAfter(step))] * 2
    assert len(densified) == measured


def test_an_error_in_one_component_refuses_that_one(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    stubbed: tuple[list[DepthMap], Similarity, TileWorld],
) -> None:
    maps, _, world = stubbed
    monkeypatch.setattr(pipeline_ground, "exhaustive", fails_on_many)
    monkeypatch.setattr(pipeline_ground, "densify_component", lambda _, level, *__: maps[: len(level.cameras)])
    options = Options(ground=GroundChoices(method="exhaustive"))
    with Store.open(tmp_path) as store:
        ((broken, whole),) = register_ground_sets([ground_job(store, options)], [airborne_of(world)], photos_of(world))
    assert not broken.registration.registered
    assert broken.registration.reason == "internal error (LinAlgError: Singular matrix); run.log has the traceback"
    assert whole.registration.registered
    assert "Traceback" in caplog.text and "ground0-0: failed unexpectedly" in caplog.text


def test_a_set_whose_reconstruction_fails_costs_no_other(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    stubbed: tuple[list[DepthMap], Similarity, TileWorld],
) -> None:
    maps, _, world = stubbed

    def reconstruct(stage: str, *_: Any) -> list[Component]:
        if stage.startswith("ground0"):
            raise ValueError("no valid pose")
        return [component_of(maps)]

    monkeypatch.setattr(pipeline_ground, "reconstruct_set", reconstruct)
    monkeypatch.setattr(pipeline_ground, "exhaustive", fails_on_many)
    with Store.open(tmp_path) as store:
        job = ground_job(store, Options(ground=GroundChoices(method="exhaustive")))
        jobs = [job, replace(job, name="ground1")]
        nothing, found = register_ground_sets(jobs, [airborne_of(world)], photos_of(world))
    assert nothing == [] and len(found) == 1
    assert "Traceback" in caplog.text and "ground0: reconstruction: failed unexpectedly" in caplog.text


def fails_on_many(maps: Sequence[DepthMap], *_: Any, **__: Any) -> Registration:
    if len(maps) > 2:
        raise np.linalg.LinAlgError("Singular matrix")
    return Registration(True, "", Similarity.identity(), diagnostics={"score": 30.0})


@dataclass(frozen=True)
class Metres:
    """Says the true distances of the world's walk, times a factor."""

    factor: float
    metres_per_unit: float

    def __call__(self, image: np.ndarray, focal_px: float) -> np.ndarray:
        assert focal_px == 76.0
        depths = {m.rgb.tobytes(): m.depth for m in floated(TileWorld().walk(), tilt_deg=0.0)[0]}
        return np.asarray(self.factor * self.metres_per_unit * depths[image.tobytes()], np.float32)


SEARCHED: list[ConsensusOptions] = []


def noted(maps: Any, renders: Any, matcher: Any, options: ConsensusOptions, **_: Any) -> Registration:
    SEARCHED.append(options)
    return Registration(False, "not searched", None)


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
    SEARCHED.clear()
    monkeypatch.setattr(pipeline_ground, "exhaustive", noted)
    monkeypatch.setattr(pipeline_ground, "EXHAUSTIVE", ConsensusOptions(min_scale=0.01, max_scale=100.0))
    network: Any = Metres(factor, enu_from_level.scale)
    ground = GroundChoices(method="exhaustive", metric="metric_depth")
    options = Options(engines=Engines(metric_depth=network), ground=ground)
    with Store.open(tmp_path) as store:
        ((first, second),) = register_ground_sets([ground_job(store, options)], [airborne_of(world)], photos_of(world))
    assert first.metric is not None
    assert first.metric.metres_per_unit == pytest.approx(factor * enu_from_level.scale, rel=0.02)
    assert second.metric is not None
    low, high = SEARCHED[0].min_scale, SEARCHED[0].max_scale
    if narrowed:
        assert 0.5 * enu_from_level.scale < low < enu_from_level.scale < high < 2.0 * enu_from_level.scale
        width_m = np.median([np.nanmedian(m.depth) for m in first.depths]) * 96 / 76 * factor * enu_from_level.scale
        assert SEARCHED[0].pictures.tile_px == pytest.approx(max(150, width_m / 0.33), rel=0.1)
    else:
        assert (low, high) == (0.01, 100.0)
        assert SEARCHED[0].pictures.tile_px == 900
