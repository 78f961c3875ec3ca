# SPDX-License-Identifier: Apache-2.0
"""The plugin in QGIS without a window, on a script in place of the skymoor command."""

from __future__ import annotations

import json
import shutil
import time
from configparser import ConfigParser
from pathlib import Path
from typing import Any

import pytest

import skymoor
from skymoor.results.formats.cameras import cameras_geojson
from skymoor.results.read import Result
from support.finished import finished_run
from support.qgis_plugin import PLUGIN, qgis_python, qgis_session, write_command

needs_qgis = pytest.mark.skipif(
    qgis_python() is None,
    reason="no QGIS on this machine; install qgis and python3-qgis, or name its Python in QGIS_PYTHON",
)
LINES = 'echo "search: 12 done in 3 s"; echo "match: 1 done in 1 s"'


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A finished run, its photos and its reference."""
    finished_run(tmp_path)
    run = tmp_path / "run"
    (run / "cameras.geojson").write_text(_cameras(run), encoding="utf-8")
    return tmp_path


def _cameras(run: Path) -> str:
    return json.dumps(cameras_geojson(Result.read(run).cameras))


def registered(site: Path, body: str, algorithm: str = "registerphotos", **more: Any) -> dict[str, Any]:
    """What came of the algorithm with a command of that body."""
    reference = {"ORTHO": str(site / "ortho.tif"), "DSM": str(site / "dsm.tif"), "VERTICAL_DATUM": "ellipsoid"}
    data = {"MODEL": str(site / "ortho.tif")} if algorithm == "registermodel" else {"AIRBORNE": str(site / "air")}
    parameters = {**reference, **data, "CE90": 2.1, "LE90": 3.8, "OUTPUT": str(site / "out")}
    job = {"algorithm": f"skymoor:{algorithm}", "command": str(write_command(site, body)), "parameters": parameters}
    return qgis_session(site, **job, **more)


def copied(site: Path, status: int) -> str:
    """A body that leaves the finished run in the folder it is told."""
    keep = f'printf \'%s\\n\' "$@" > {site}/words; while [ "$1" != --out ]; do shift; done'
    return f'{keep}; {LINES}; mkdir -p "$2"; cp -r {site}/run/. "$2"; exit {status}'


@needs_qgis
@pytest.mark.parametrize("status", [0, 3])
def test_results_are_loaded_with_their_styles(status: int, site: Path) -> None:
    found = registered(site, copied(site, status))
    assert sorted(found["algorithms"]) == ["skymoor:registermodel", "skymoor:registerphotos"]
    assert found["error"] == "" and found["results"]["REGISTERED"] is (status == 0)
    words = (site / "words").read_text().splitlines()
    assert words[:3] == ["run", "--airborne", str(site / "air")] and words[words.index("--ce90") + 1] == "2.1"
    layers = {layer["name"]: layer for layer in found["layers"]}
    assert set(layers) == {"out: cameras", "out: orthophoto", "out: DSM"} and all(
        one["valid"] for one in layers.values()
    )
    cameras = layers["out: cameras"]
    assert cameras["features"] == 10 and cameras["categories"] == ["REGISTERED", "NOT_REGISTERED"]
    # The diameter of CE90, in metres of the map.
    assert cameras["size"] == ['coalesce(2 * "ce90", 0)'] and cameras["circle"]["size_unit"] == "RenderMetersInMapUnits"
    assert '"image"' in cameras["label"] and layers["out: DSM"]["renderer"] == "hillshade"
    assert found["order"] == ["out: cameras", "out: orthophoto", "out: DSM"]
    assert found["said"]["info"][0] == "airborne_0: registered, CE90 2.1 m, LE90 3.8 m"
    assert any(
        line == "ground0_0: not registered, and no position is written: no wall fits"
        for line in found["said"]["warning"]
    )
    assert 0 < found["said"]["progress"][0] < found["said"]["progress"][1] < 100


@needs_qgis
def test_wrong_input_is_one_line(site: Path) -> None:
    found = registered(site, 'echo "skymoor: dsm.tif: has no CRS; assign one" >&2; exit 2', "registermodel")
    assert found["error"] == "the input is not accepted: dsm.tif: has no CRS; assign one"
    assert found["layers"] == [] and not (site / "out").exists()


@needs_qgis
def test_a_refused_model_loads_nothing_and_says_why(site: Path) -> None:
    shutil.rmtree(site / "run")
    for name in ("ortho.tif", "dsm.tif"):
        (site / name).rename(site / f"kept_{name}")
    shutil.rmtree(site / "air")
    finished_run(site, registered=False)
    found = registered(site, copied(site, 3), "registermodel")
    assert found["error"] == "" and found["results"]["REGISTERED"] is False and found["layers"] == []
    assert any("a competing hypothesis scores 85" in line for line in found["said"]["warning"])
    assert (site / "words").read_text().splitlines()[:2] == ["register", str(site / "ortho.tif")]


@needs_qgis
def test_cancelling_ends_the_command(site: Path) -> None:
    found = registered(
        site,
        f"echo $$ > {site}/id; trap 'echo > {site}/asked; exit 143' TERM; while :; do sleep 0.1; done",
        cancel_after_s=1.0,
    )
    assert found["error"] == "" and found["layers"] == [] and 0.9 < found["seconds"] < 8
    assert (site / "asked").is_file()
    number = (site / "id").read_text().strip()
    for _ in range(40):
        if not Path(f"/proc/{number}").exists():
            break
        time.sleep(0.05)
    assert not Path(f"/proc/{number}").exists()


def test_the_plugin_states_what_qgis_requires() -> None:
    facts = ConfigParser()
    facts.read(PLUGIN / "metadata.txt", encoding="utf-8")
    assert {"name", "version", "description", "about", "author", "email", "qgisminimumversion"} <= set(facts["general"])
    assert facts["general"]["version"] == skymoor.__version__
    assert facts["general"]["hasprocessingprovider"] == "yes"
    assert {path.name for path in (PLUGIN / "styles").iterdir()} == {"cameras.qml", "dsm.qml"}
