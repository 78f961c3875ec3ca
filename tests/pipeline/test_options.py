# SPDX-License-Identifier: Apache-2.0
"""Every engine can be chosen by an option, is what runs then, and is missed before the work begins."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from skymoor.engines.choice import Choice, files_of
from skymoor.errors import BackendUnavailable, InputError
from skymoor.pipeline.option_parser import option_names, with_options
from skymoor.pipeline.options import Options, check_engines

CHOICES = (
    "reconstruct.matcher",
    "reconstruct.matcher.dedode_roma.dense",
    "reconstruct.pair_filter",
    "labels",
    "densify",
    "model.monocular",
    "match.dense",
    "ground.reconstruct.matcher",
    "ground.reconstruct.matcher.dedode_roma.dense",
    "ground.reconstruct.pair_filter",
    "ground.labels",
    "ground.densify",
    "ground.metric",
    "ground.matcher",
    "ground.cascade.retriever",
)
# What else must be set for a choice to matter.
IN_USE: dict[str, dict[str, object]] = {
    "reconstruct.matcher.dedode_roma.dense": {"reconstruct.matcher.kind": "dedode_roma"},
    "ground.reconstruct.matcher.dedode_roma.dense": {"ground.reconstruct.matcher.kind": "dedode_roma"},
    "model.monocular": {"model.kind": "nerf"},
    "ground.matcher": {"ground.method": "exhaustive"},
    "ground.cascade.retriever": {"ground.method": "cascade"},
}


def at(options: Options, name: str) -> Any:
    found: Any = options
    for part in name.split("."):
        found = getattr(found, part)
    return found


@pytest.fixture(autouse=True)
def no_weights_and_no_programs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path / "weights"))
    monkeypatch.setenv("PATH", str(tmp_path / "programs"))


def test_no_choice_is_forgotten_here() -> None:
    assert {name.removesuffix(".kind") for name in option_names(Options()) if name.endswith(".kind")} == {
        *CHOICES,
        "model",
    }


@pytest.mark.parametrize("name", CHOICES)
def test_each_kind_chooses_its_engine(name: str) -> None:
    choice = at(Options(), name)
    assert isinstance(choice, Choice)
    kinds = get_args(get_type_hints(type(choice))["kind"])
    assert choice.kind in kinds and len(kinds) > 1
    for kind in kinds:
        chosen = at(with_options(Options(), {f"{name}.kind": kind}), name)
        assert chosen.engine is (None if kind == "none" else getattr(chosen, kind))
        assert callable(chosen.engine) or kind == "none"
    with pytest.raises(InputError, match="must be one of"):
        with_options(Options(), {f"{name}.kind": "another"})


@pytest.mark.parametrize("name", CHOICES)
def test_what_is_missing_is_told_before_the_work_and_only_where_it_is_used(name: str) -> None:
    """Here nothing is installed and nothing fetched: all engines but those of the offline default are missing."""
    offline = {"none", "sift", "conflicts", "sgm", "structural", "channels"}
    kinds = get_args(get_type_hints(type(at(Options(), name)))["kind"])
    for kind in kinds:
        if kind in offline:
            continue
        chosen = with_options(Options(), {f"{name}.kind": kind, **IN_USE.get(name, {})})
        with pytest.raises(BackendUnavailable) as told:
            check_engines(chosen)
        assert "\n" not in str(told.value)
        if name.startswith("ground."):
            check_engines(chosen, ground=False)
        elif name in IN_USE:
            check_engines(with_options(Options(), {f"{name}.kind": kind}))
    check_engines(Options())


def test_files_of_those_that_read_none() -> None:
    assert files_of(None, object(), Options().match.dense) == ()
