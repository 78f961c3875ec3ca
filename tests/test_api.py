# SPDX-License-Identifier: Apache-2.0
"""skymoor as notebooks and scripts use it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import skymoor
from skymoor import api
from skymoor.cli import commands
from skymoor.cli.arguments import Run
from skymoor.pipeline.option_parser import parse_option
from support.finished import finished_run

LEARNED = {"torch", "pycolmap", "plotly", "cv2", "numpy"}


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Run]:
    """What `register` asked `skymoor run` for, which has left a run of which nothing is registered."""
    runs: list[Run] = []

    def run(command: Run) -> bool:
        finished_run(command.out.parent, registered=False)
        runs.append(command)
        return False

    monkeypatch.setattr(commands, "run", run)
    return runs


def test_importing_costs_nothing() -> None:
    ask = "import sys, skymoor; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "skymoor" in loaded and loaded.isdisjoint(LEARNED)


@pytest.mark.parametrize("first", ["", "import skymoor.pipeline.airborne;", "from skymoor.registration import decide;"])
def test_the_name_of_the_stage_stays_with_the_function(first: str) -> None:
    ask = f"{first}import skymoor; print(callable(skymoor.register), skymoor.registration.__module__)"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "skymoor.api"]


def test_what_there_is() -> None:
    assert {"register", "read", "Result", "InputError"} <= set(dir(skymoor))
    assert skymoor.read is api.read and skymoor.register is api.register
    with pytest.raises(AttributeError, match="no attribute 'rigister'"):
        skymoor.rigister  # noqa: B018


def test_a_site_is_placed_and_read_back(tmp_path: Path, asked: list[Run]) -> None:
    result = skymoor.register(
        tmp_path / "site.toml", out=tmp_path / "run", options={"match": {"max_height_m": 150}}, seed=4
    )
    assert not result.registered  # is no error: the result says so
    assert result.components[0].reason == "another place is nearly as good"
    (command,) = asked
    assert command == Run(
        site=tmp_path / "site.toml", out=tmp_path / "run", set=("match.max_height_m=150",), seed=4, quiet=True
    )


def test_the_data_by_name(tmp_path: Path, asked: list[Run]) -> None:
    skymoor.register(
        **{"airborne": "air", "ground": "walk", "ortho": "o.tif", "dsm": "d.tif", "out": str(tmp_path / "run")},
        **{"vertical_datum": "ellipsoid", "ce90": 2.1, "le90": 3.8},
    )
    (command,) = asked
    assert (command.site, command.airborne, command.ground) == (None, Path("air"), (Path("walk"),))
    assert (command.ortho, command.dsm, command.ce90, command.le90) == (Path("o.tif"), Path("d.tif"), 2.1, 3.8)


@pytest.mark.parametrize(
    "value",
    [150, 1.5, 1e-7, True, "mesh", "1.5", 'a "b" \\ ä\n', [1, 2.5], ["a", "b"], np.float64(0.25), np.int32(7)],
)
def test_options_keep_their_types(value: object) -> None:
    (setting,) = api._settings({"group": {"name": value}})
    name, parsed = parse_option(setting)
    assert name == "group.name" and parsed == value and isinstance(value, type(parsed) | np.generic)


def test_wrong_input_is_told(tmp_path: Path) -> None:
    with pytest.raises(skymoor.InputError, match=r"none\.toml: there is no such file"):
        skymoor.register(tmp_path / "none.toml", out=tmp_path / "out")
    with pytest.raises(skymoor.InputError, match=r"match\.seed = \{1\} is no number"):
        skymoor.register(tmp_path / "none.toml", out=tmp_path / "out", options={"match.seed": {1}})
    with pytest.raises(skymoor.InputError, match="no summary of a finished run"):
        skymoor.read(tmp_path)
