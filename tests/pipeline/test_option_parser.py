# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from skymoor.errors import InputError
from skymoor.pipeline.option_parser import option_names, parse_option, with_options


@dataclass(frozen=True)
class Match:
    cycle_px: float = 2.0
    windows: int = 8
    heights: bool = True
    span: tuple[float, float] = (0.5, 2.0)

    def __post_init__(self) -> None:
        if self.span[0] >= self.span[1]:
            raise ValueError("span must grow")


@dataclass(frozen=True)
class Config:
    match: Match = field(default_factory=Match)
    kind: Literal["mesh", "field"] = "mesh"
    weights: Path | None = None
    budget: int | None = 5
    angles: tuple[int, ...] = ()


def test_nested_and_dotted_spellings_mean_the_same() -> None:
    nested = with_options(Config(), {"match": {"cycle_px": 3, "windows": 4}, "kind": "field"})
    dotted = with_options(Config(), {"match.cycle_px": 3.0, "match.windows": 4, "kind": "field"})
    assert nested == dotted == Config(match=Match(cycle_px=3.0, windows=4), kind="field")
    assert type(nested.match.cycle_px) is float
    assert Config().match.cycle_px == 2.0


def test_later_spelling_wins() -> None:
    assert with_options(Config(), {"match": {"windows": 3}, "match.windows": 6}).match.windows == 6


def test_fields_that_depend_on_each_other_are_set_together() -> None:
    assert with_options(Config(), {"match.span": [3, 4]}).match.span == (3.0, 4.0)
    with pytest.raises(InputError, match="span must grow"):
        with_options(Config(), {"match.span": [4, 3]})


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [("weights", "a/b.pt", Path("a/b.pt")), ("budget", "none", None), ("budget", 7, 7), ("angles", [1, 2], (1, 2))],
)
def test_types_are_converted(name: str, value: object, expected: object) -> None:
    assert getattr(with_options(Config(), {name: value}), name) == expected


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("match.cycle_px", True),
        ("match.cycle_px", "3"),
        ("match.cycle_px", float("nan")),
        ("match.windows", 3.0),
        ("match.windows", True),
        ("match.heights", 1),
        ("match.span", [1, 2, 3]),
        ("match.span", 1.0),
        ("kind", "nerf"),
        ("kind", True),
        ("budget", "many"),
        ("angles", [1, "x"]),
        ("match", 3),
        ("match.cycle_px.deep", 3),
    ],
)
def test_wrong_types_are_refused(name: str, value: object) -> None:
    with pytest.raises(InputError, match=name.split(".")[0]):
        with_options(Config(), {name: value})


@pytest.mark.parametrize(
    ("name", "hint"),
    [("match.cycle_pxx", r"match\.cycle_px\b"), ("mach.windows", r"match\.windows"), ("cycle_px", r"match\.cycle_px")],
)
def test_misspelt_option_names_the_nearest(name: str, hint: str) -> None:
    with pytest.raises(InputError, match=rf"site\.toml: there is no option {name}; did you mean .*{hint}"):
        with_options(Config(), {name: 1}, source="site.toml")


def test_option_names_lists_every_leaf() -> None:
    assert list(option_names(Config())) == [
        *("match.cycle_px", "match.windows", "match.heights", "match.span"),
        *("kind", "weights", "budget", "angles"),
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("match.cycle_px=3", ("match.cycle_px", 3)),
        (" a = 2.5 ", ("a", 2.5)),
        ("a=true", ("a", True)),
        ("a=[1, 2]", ("a", [1, 2])),
        ("a=mesh", ("a", "mesh")),
        ('a="3"', ("a", "3")),
        ("a=x=y", ("a", "x=y")),
        ("a=2024-01-01", ("a", "2024-01-01")),
        ("a=1\nb=2", ("a", "1\nb=2")),
        ("a=", ("a", "")),
    ],
)
def test_parse_option(text: str, expected: tuple[str, object]) -> None:
    name, value = parse_option(text)
    assert (name, value) == expected
    assert type(value) is type(expected[1])


@pytest.mark.parametrize("text", ["match.cycle_px", "=3", ""])
def test_parse_option_without_name_or_value(text: str) -> None:
    with pytest.raises(InputError, match="NAME=VALUE"):
        parse_option(text)
