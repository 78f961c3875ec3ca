# SPDX-License-Identifier: Apache-2.0
"""Few options, shallow; every engine can be chosen by name, and is missed before the work begins."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import pytest

from skymoor.errors import BackendUnavailable, InputError
from skymoor.pipeline.engines import Engines
from skymoor.pipeline.option_docs import descriptions_of
from skymoor.pipeline.option_parser import option_fields, option_names, option_values, with_options
from skymoor.pipeline.options import Options, check_engines
from skymoor.pipeline.prior import KEYS as PRIOR_KEYS
from skymoor.pipeline.site import REFERENCE_KEYS
from skymoor.pipeline.site_control import KEYS as CONTROL_KEYS
from skymoor.pipeline.site_schema import site_schema

CHOICES = (
    "reconstruct.matcher",
    "reconstruct.pair_filter",
    "orient.labels",
    "densify.method",
    "model.ranking",
    "match.matcher",
    "ground.matcher",
    "ground.retriever",
    "ground.labels",
    "ground.metric",
    "ground.densify",
    "ground.reconstruct.matcher",
    "ground.reconstruct.pair_filter",
)
# What else must be set for a choice to matter.
IN_USE: dict[str, dict[str, object]] = {
    "model.ranking": {"model.kind": "nerf"},
    "ground.matcher": {"ground.method": "exhaustive"},
    "ground.retriever": {"ground.method": "cascade"},
}
OFFLINE = {"none", "sift", "conflicts", "sgm", "structural", "channels"}


def group_of(name: str) -> tuple[Any, str]:
    """The group of an option, and its own name."""
    found: Any = Options()
    *groups, last = name.split(".")
    for part in groups:
        found = getattr(found, part)
    return found, last


def kinds_of(name: str) -> tuple[str, ...]:
    group, last = group_of(name)
    return get_args(get_type_hints(type(group))[last])


@pytest.fixture(autouse=True)
def no_weights_and_no_programs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path / "weights"))
    monkeypatch.setenv("PATH", str(tmp_path / "programs"))


def test_options_are_few_and_shallow() -> None:
    names = list(option_names(Options()))
    assert 80 < len(names) < 250 and len(set(names)) == len(names)
    assert max(name.count(".") + 1 for name in names) <= 4
    # The device is said once, and each engine's weights once.
    assert [name for name in names if name.endswith("device")] == ["engines.device"]
    assert all(name.startswith("engines.") for name in names if name.endswith("weights"))


def test_every_option_says_what_it_is() -> None:
    def untold(group: Any, prefix: str) -> list[str]:
        told, found = descriptions_of(type(group)), []
        for item in option_fields(group):
            value = getattr(group, item.name)
            if hasattr(value, "__dataclass_fields__"):
                found += untold(value, f"{prefix}{item.name}.")
            elif not told.get(item.name):
                found.append(prefix + item.name)
        return found

    assert untold(Options(), "") == []


def test_no_choice_is_forgotten_here() -> None:
    engines = {item.name for item in fields(Engines)} | {"none", "dedode_roma"}
    choices = {
        name
        for name in option_names(Options())
        if get_origin(get_type_hints(type(group_of(name)[0]))[group_of(name)[1]]) is not None
        and set(kinds_of(name)) <= engines
    }
    assert choices == set(CHOICES)


@pytest.mark.parametrize("name", CHOICES)
def test_what_is_missing_is_told_before_the_work_and_only_where_it_is_used(name: str) -> None:
    """Here nothing is installed and nothing fetched: all engines but those of the offline default are missing."""
    kinds = kinds_of(name)
    assert len(kinds) > 1
    for kind in kinds:
        chosen = with_options(Options(), {name: kind, **IN_USE.get(name, {})})
        if kind in OFFLINE:
            continue
        with pytest.raises(BackendUnavailable) as told:
            check_engines(chosen)
        assert "\n" not in str(told.value)
        if name.startswith("ground."):
            check_engines(chosen, ground=False)
        elif name in IN_USE:
            check_engines(with_options(Options(), {name: kind}))
    with pytest.raises(InputError, match="must be one of"):
        with_options(Options(), {name: "another"})


def test_what_users_cannot_sensibly_set_is_no_option() -> None:
    with pytest.raises(InputError, match=r"there is no option match\.search\.channels\.slope; did you mean") as told:
        with_options(Options(), {"match.search.channels.slope": 1.0})
    assert len(str(told.value)) < 300
    with pytest.raises(InputError) as told:
        with_options(Options(), {"xyzzy": 1.0})
    assert "engines.*" in str(told.value) and len(str(told.value)) < 300 and "\n" not in str(told.value)


def test_values_are_those_of_the_options_alone() -> None:
    values = option_values(with_options(Options(), {"match.max_height_m": 150}))
    assert values["match"]["max_height_m"] == 150.0  # type: ignore[index]
    assert "channels" not in values["match"]["search"]  # type: ignore[index]
    json.dumps(values)


def test_the_schema_knows_every_option() -> None:
    schema = site_schema()
    for name in option_names(Options()):
        table = schema["properties"]["options"]
        for part in name.split("."):
            assert table["additionalProperties"] is False
            table = table["properties"][part]
        assert table["description"] and ("type" in table or "enum" in table or "anyOf" in table)
    assert schema["properties"]["options"]["properties"]["model"]["properties"]["kind"]["enum"] == ["mesh", "nerf"]
    json.dumps(schema)


def test_the_schema_knows_every_key_of_a_site() -> None:
    tables = site_schema()["properties"]
    assert set(tables["reference"]["properties"]) == set(REFERENCE_KEYS)
    assert set(tables["prior"]["properties"]) == set(PRIOR_KEYS)
    assert set(tables["control"]["properties"]) == set(CONTROL_KEYS)
