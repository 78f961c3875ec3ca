# SPDX-License-Identifier: Apache-2.0
"""Training: repeatable, resumable, and with every loss of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from model.nerf.toy import TINY, Toy, component_of
from skymoor.errors import DegenerateGeometry
from skymoor.model.nerf import LossWeights
from skymoor.model.nerf.model import NerfModel
from skymoor.model.nerf.train import Schedule, Trainer

SHORT = 40


def weights_of(model: NerfModel) -> torch.Tensor:
    return torch.cat([parameter.detach().flatten() for parameter in model.field.parameters()])


def interrupted(toy: Toy, checkpoint: Path, steps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Train until the process dies after so many steps; a checkpoint is written before each."""
    step = Trainer.step

    def dying(self: Trainer, done: float) -> dict[str, torch.Tensor]:
        if self.steps == steps:
            raise KeyboardInterrupt
        self.save(checkpoint, checkpoint_key(self))
        return step(self, done)

    keys: dict[str, str] = {}
    run = Trainer.run

    def told(self: Trainer, schedule: Schedule, *others: object) -> None:
        keys["key"] = schedule.key
        run(self, schedule, *others)  # type: ignore[arg-type]

    def checkpoint_key(_: Trainer) -> str:
        return keys["key"]

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "step", dying)
        patch.setattr(Trainer, "run", told)
        with pytest.raises(KeyboardInterrupt):
            toy.with_sizes(iterations=SHORT)(component_of(toy.exact), toy.exact, checkpoint=checkpoint)


def test_the_same_seed_gives_the_same_field(toy: Toy) -> None:
    builder = toy.with_sizes(iterations=10)
    models = [builder(component_of(toy.exact), toy.exact) for _ in range(2)]
    torch.testing.assert_close(weights_of(models[0]), weights_of(models[1]), rtol=0, atol=0)
    other = replace(builder, seed=1)(component_of(toy.exact), toy.exact)
    assert (weights_of(other) - weights_of(models[0])).abs().max() > 1e-3


def test_a_resumed_training_ends_like_an_uninterrupted_one(
    toy: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = tmp_path / "field.pt"
    builder = toy.with_sizes(iterations=SHORT)
    whole = builder(component_of(toy.exact), toy.exact)
    interrupted(toy, checkpoint, 25, monkeypatch)
    told: list[float] = []

    def report(found: Mapping[str, float]) -> None:
        told.append(found["step"])

    resumed = builder(component_of(toy.exact), toy.exact, checkpoint=checkpoint, report=report)
    # The checkpoint holds 24 steps: the report of step 20 was the dead process's.
    assert told == [40]
    torch.testing.assert_close(weights_of(resumed), weights_of(whole), rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(resumed.proposal.density, whole.proposal.density, rtol=1e-5, atol=1e-6)
    assert not checkpoint.exists()


@pytest.mark.parametrize("damage", ["other options", "cut off", "a bit of its head", "a bit of its numbers"])
def test_a_checkpoint_that_does_not_fit_is_ignored(
    toy: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    checkpoint = tmp_path / "field.pt"
    interrupted(toy, checkpoint, 5, monkeypatch)
    builder = toy.with_sizes(iterations=10)
    if damage != "other options":
        builder = toy.with_sizes(iterations=SHORT)
        content = bytearray(checkpoint.read_bytes())
        content[150 if "head" in damage else len(content) // 2] ^= 16
        checkpoint.write_bytes(content[:1000] if damage == "cut off" else content)
    fresh = builder(component_of(toy.exact), toy.exact)
    again = builder(component_of(toy.exact), toy.exact, checkpoint=checkpoint)
    torch.testing.assert_close(weights_of(again), weights_of(fresh), rtol=0, atol=0)


def test_the_clock_ends_a_training(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = iter(np.arange(0.0, 1e6, 1.0))
    monkeypatch.setattr("skymoor.model.nerf.train.time.monotonic", lambda: float(next(seconds)))
    steps: list[float] = []
    step = Trainer.step

    def counted(self: Trainer, done: float) -> dict[str, torch.Tensor]:
        steps.append(done)
        return step(self, done)

    monkeypatch.setattr(Trainer, "step", counted)
    replace(toy.with_sizes(iterations=1000), budget_s=9.5)(component_of(toy.exact), toy.exact)
    assert 5 < len(steps) < 11
    assert (np.diff(steps) > 0).all()
    assert steps[-1] > 0.8


def test_reports_say_how_it_goes(toy: Toy) -> None:
    told: list[Mapping[str, float]] = []
    done: list[tuple[int, int]] = []
    toy.with_sizes(iterations=60)(
        component_of(toy.exact), toy.exact, report=told.append, progress=lambda a, b, note="": done.append((a, b))
    )
    assert [found["step"] for found in told] == [20, 40, 60]
    assert told[-1]["psnr_db"] > 15
    assert 0 < told[-1]["depth_error"] < 0.01  # level units
    assert told[0]["left_s"] > told[-1]["left_s"] >= 0
    assert done[-1] == (1000, 1000)


def test_a_loss_that_is_no_number_is_skipped_then_refused(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = {"left": 3}

    def spoilt(*_: torch.Tensor) -> torch.Tensor:
        broken["left"] -= 1
        return torch.tensor(float("nan") if broken["left"] >= 0 else 0.5)

    monkeypatch.setattr("skymoor.model.nerf.losses.photometric_loss", spoilt)
    model = toy.with_sizes(iterations=8)(component_of(toy.exact), toy.exact)
    assert torch.isfinite(weights_of(model)).all()
    broken["left"] = 1000
    with pytest.raises(DegenerateGeometry, match="diverged"):
        toy.with_sizes(iterations=50)(component_of(toy.exact), toy.exact)


def test_a_loss_of_weight_zero_changes_nothing(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    builder = replace(toy.with_sizes(iterations=5), losses=replace(LossWeights(), distortion=0.0))
    before = builder(component_of(toy.exact), toy.exact)
    monkeypatch.setattr("skymoor.model.nerf.losses.distortion_loss", lambda *_: torch.tensor(7.0))
    after = builder(component_of(toy.exact), toy.exact)
    torch.testing.assert_close(weights_of(after), weights_of(before), rtol=0, atol=0)


def test_monocular_order_counts_only_where_it_is_weighed(toy: Toy) -> None:
    # A photo that claims to see the box as a pit, where no depth map says otherwise.
    maps = [replace(m, depth=np.where(m.depth < 0.9 * np.nanmax(m.depth), m.depth, np.nan)) for m in toy.rough]
    wrong = [np.asarray(-np.nan_to_num(m.depth, nan=1.0), dtype=np.float32) for m in maps]
    builder = toy.with_sizes(iterations=20)
    plain, misled, silenced = (
        replace(builder, losses=replace(LossWeights(), ranking=weight))(component_of(maps), maps, monocular=order)
        for weight, order in ((0.1, None), (5.0, wrong), (0.0, wrong))
    )
    assert (weights_of(misled) - weights_of(silenced)).abs().max() > 1e-3
    assert len(weights_of(plain)) == len(weights_of(misled))


def test_the_huge_preset_shares_the_code(toy: Toy) -> None:
    sizes = replace(
        TINY, iterations=15, appearance=4, view_direction=True, exact_backward=True, rays=512, samples=12, hidden=32
    )
    builder = replace(toy.builder, preset="huge", huge=sizes)
    told: list[Mapping[str, float]] = []
    model = replace(builder, huge=replace(sizes, iterations=40))(component_of(toy.exact), toy.exact, report=told.append)
    assert model.texture == "field"
    assert model.field.appearance.abs().max() > 0.01
    assert told[-1]["psnr_db"] > 15
