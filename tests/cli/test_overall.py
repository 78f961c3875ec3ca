# SPDX-License-Identifier: Apache-2.0
"""The bar of the whole run: weights, steps from the cache, time left; never backwards, never above all of it."""

from __future__ import annotations

import itertools

import pytest

from skymoor.cli.overall import Overall
from skymoor.pipeline.estimate import Step, estimate_run, step_of
from skymoor.pipeline.options import Options

PLAN = {"reference": 2.0, "photos": 8.0, "reconstruct": 50.0, "depths": 20.0, "search": 10.0, "register": 10.0}


class Run:
    """A run with a clock of its own."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.bar = Overall([Step(name, "", seconds, 0.0) for name, seconds in PLAN.items()], lambda: self.now)

    def works(self, name: str, seconds: float, count: int = 10) -> None:
        """Report the progress of some work from its beginning to its end."""
        for done in range(count + 1):
            self.bar.report(name, done, count)
            self.now += seconds / count if done < count else 0.0


def test_steps_count_by_their_planned_time() -> None:
    run = Run()
    run.works("photos", 8.0)
    assert run.bar.share() == pytest.approx(0.10)
    run.works("airborne: reconstruction", 50.0)
    assert run.bar.share() == pytest.approx(0.60)
    run.bar.report("airborne-0: dense depth", 5, 10)
    assert run.bar.share() == pytest.approx(0.70)


def test_what_comes_from_the_cache_is_done_at_once_and_tells_nothing_of_the_time() -> None:
    run = Run()
    run.bar.report("airborne-0: dense depth", 0, 10)
    assert run.bar.share() == pytest.approx(0.60)
    assert run.bar.left_s() == pytest.approx(40.0)  # as planned: nothing was measured yet


def test_a_run_that_comes_from_the_cache_goes_on_to_its_end() -> None:
    run, shown = Run(), []
    for name in ("photos", "airborne: reconstruction", "airborne-0: dense depth", "search"):
        run.bar.report(name, 1, 1, cached=True)
        shown.append(run.bar.share())
        run.now += 0.1
    assert shown == pytest.approx([0.10, 0.60, 0.80, 0.90])
    assert run.bar.left_s() == pytest.approx(10.0, rel=0.02)  # as planned: what was not computed was not measured
    run.works("products", 0.0)
    assert run.bar.share() <= 0.99


@pytest.mark.parametrize("pace", [0.5, 3.0])
def test_the_time_left_follows_what_was_measured(pace: float) -> None:
    run = Run()
    run.works("airborne: reconstruction", pace * 50.0)
    left = run.bar.left_s()
    assert 0.75 * pace * 40.0 < left < 1.25 * pace * 40.0
    assert abs(left - pace * 40.0) < abs(40.0 - pace * 40.0)


def test_a_step_that_reports_nothing_goes_on_by_its_time_and_never_ends_by_it() -> None:
    run = Run()
    run.works("search", 10.0)
    before = run.bar.share()
    run.now += 5.0
    assert before < run.bar.share() < 1.0
    run.now += 1e6
    assert run.bar.share() < 1.0 and run.bar.left_s() > 0.0


def test_it_never_goes_back_and_never_above_all_of_it() -> None:
    names = ["search", "airborne: reconstruction", "nonsense", "sites", "products", "airborne-1: dense depth", "photos"]
    run, shown = Run(), [0.0]
    for name, done in itertools.product(names * 2, (0, 7, 3, 12, 10)):
        run.bar.report(name, done, 10)
        run.now += 3.0
        shown.append(run.bar.share())
        assert run.bar.left_s() >= 0.0
    assert shown == sorted(shown) and shown[-1] <= 1.0


def test_work_without_a_total_changes_nothing() -> None:
    run = Run()
    run.bar.report("search", 0, 0)
    assert run.bar.share() == 0.0


def test_progress_belongs_to_steps_of_the_plan() -> None:
    plan = [step.name for step in estimate_run([(640, 480)] * 9, [[(640, 480)] * 5], 10_000, Options())]
    names = ["reference", "photos", "ground0.photos", "airborne: reconstruction", "airborne-0: dense depth", "model"]
    names += ["nadir view", "search", "decoys", "walls", "ground0: reconstruction", "ground0-0: dense depth"]
    names += ["ground0-0: walls", "products"]
    steps = [step_of(name) for name in names]
    places = [plan.index(step[0]) for step in steps if step is not None]
    assert len(places) == len(names) and places == sorted(places)  # in the order in which a run reports them
    assert step_of("DJI_0001.MP4") is None
