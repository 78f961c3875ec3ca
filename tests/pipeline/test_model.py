# SPDX-License-Identifier: Apache-2.0
"""The model's stage: depths of single photos reach the radiance field where they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from skymoor.errors import BackendUnavailable
from skymoor.pipeline import airborne as pipeline
from skymoor.pipeline.engines import Engines
from skymoor.pipeline.job import Job
from skymoor.pipeline.option_parser import with_options
from skymoor.pipeline.options import ModelOptions, Options, check_engines
from skymoor.store import Store
from skymoor.types import DepthMap, no_progress
from support.tile_world import TileWorld


@dataclass(frozen=True)
class Order:
    """Says of each photo how bright it is."""

    asked: ClassVar[list[int]] = []

    def ready(self) -> tuple[Path, ...]:
        return ()

    def __call__(self, image: np.ndarray) -> np.ndarray:
        self.asked.append(len(self.asked))
        return image[..., 0].astype(np.float32)


@dataclass(frozen=True)
class Builder:
    """Keeps what it was given."""

    device: str = "auto"
    given: ClassVar[dict[str, Any]] = {}

    def __call__(self, component: Any, depths: Sequence[DepthMap], **given: Any) -> list[str]:
        self.given.update(given)
        return ["a model"]


def test_depths_of_single_photos_reach_the_field(tmp_path: Path) -> None:
    maps, order, builder = TileWorld().walk(3), Order(), Builder()
    engines: Any = {"marigold": order}
    model: Any = {"kind": "nerf", "ranking": "marigold", "nerf": builder}
    options = Options(engines=Engines(**engines), model=ModelOptions(**model))
    nothing: Any = None
    for run in range(2):
        with Store.open(tmp_path) as store:
            job = Job(nothing, nothing, options, store, 0, lambda _: no_progress)
            built: Any = pipeline._model("a", nothing, maps, job)
            assert built == ["a model"]
        assert len(order.asked) == 3, run  # the second time both stages are kept
    assert [m.shape for m in builder.given["monocular"]] == [m.depth.shape for m in maps]
    np.testing.assert_array_equal(builder.given["monocular"][1], maps[1].rgb[..., 0])


def test_nothing_is_asked_for_a_mesh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path))
    mesh = with_options(Options(), {"model.ranking": "depth_anything"})
    check_engines(mesh)
    with pytest.raises(BackendUnavailable):
        check_engines(with_options(mesh, {"model.kind": "nerf"}))
