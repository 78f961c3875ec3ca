# SPDX-License-Identifier: Apache-2.0
"""site.toml, truth.csv, cameras.csv, summary.json, --set: whatever they hold, nothing but `InputError` comes out."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from skymoor.cli.arguments import Evaluate
from skymoor.cli.commands import evaluate
from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.pipeline.control_files import read_control
from skymoor.pipeline.control_places import Stated
from skymoor.pipeline.options import Options
from skymoor.pipeline.reference_files import earlier_run
from skymoor.pipeline.site import load_site, parse_option, with_options
from skymoor.results.read import Result
from skymoor.results.request import site_of_run
from skymoor.results.tables import read_cameras_csv, read_truth_csv
from support.finished import summary_of_run
from support.tiny_site import SITE, make_site

FUZZED = settings(
    max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
FULL = (
    'name = "x"\n' + SITE + '[[ground]]\nimages = "airborne"\n[options]\n"match.candidates" = 2\nregister.min_score=3\n'
)
TRUTH = 'image,lat,lon,height\nairborne/0.png,47.1,8.2,500\n"a, b.png",-1e1,+3,.5\n'
CAMERAS = (
    "image,set,component,status,lat,lon,height,east,north,up,qw,qx,qy,qz,ce90,le90\n"
    "a.png,airborne,0,REGISTERED,47.1,8.2,500,0,0,0,1,0,0,0,2.5,3.8\nb.png,airborne,,NOT_REGISTERED,,,,,,,,,,,,\n"
)
# What breaks parsers: ends of numbers, of text and of tables, and what looks like a number and is none.
SPLINTERS = st.sampled_from(
    [
        "\0",
        "\r",
        "\n\n",
        '"',
        "'",
        '"""',
        "[",
        "]]",
        "{",
        "#",
        ",",
        ";",
        "=",
        ".",
        "\ufeff",
        "\u2028",
        "é",
        "😀",
        "..",
        "/",
    ]
    + ["nan", "inf", "-inf", "1e999", "0x1f", "1_000", "٣", "9" * 400, "1" * 5000, "true", "1979-05-27", "[" * 3000]
    + ["= [", "a.b.c = 1\n", "[reference]\n", "x" * 5000, "-0", "1e-400", "\\", "\\u0000", "'''"]
)


@st.composite
def mutated(draw: st.DrawFn, text: str) -> bytes:
    """A valid file with a few pieces cut out, doubled, overwritten or put in."""
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.integers(0, 12)))
        piece = draw(SPLINTERS | st.text(max_size=4) | st.just("") | st.just(text[start:end] * 2))
        text = text[:start] + piece + text[end:]
    raw = text.encode("utf-8", "surrogatepass")
    return raw[: draw(st.integers(0, len(raw)))] if draw(st.integers(0, 9)) == 0 else raw


def anything(valid: str) -> st.SearchStrategy[bytes]:
    return mutated(valid) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")) | st.binary()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_site(tmp_path_factory.mktemp("fuzzed") / "site")


@FUZZED
@given(anything(FULL))
@example(b"a = " + b"[" * 5000)
@example(SITE.replace("2.5", "1" * 5000).encode())
@example(SITE.replace("2.5", "1" + "0" * 400).encode())
@example(SITE.replace("ortho.tif", "x" * 5000).encode())
@example(SITE.replace("ortho.tif", "\\u0000").encode())
@example(SITE.replace("2.5", "1e300").encode())
@example((SITE + f"[prior]\nnear = [47, 8, 1{'0' * 400}]").encode())
@example((SITE + "[options]\n'match.min_height_m' = 1" + "0" * 400).encode())
@example(SITE.replace("ce90 = 2.5\nle90 = 3.8", f"covariance = [[1{'0' * 400},0,0],[0,1,0],[0,0,1]]").encode())
def test_site_toml(site: Path, raw: bytes) -> None:
    path = site / "fuzzed.toml"
    path.write_bytes(raw)
    try:
        found = load_site(path)
        with_options(Options(), found.options)
    except InputError as error:
        assert str(error)
        return
    assert np.linalg.eigvalsh(found.reference.covariance).min() > 0
    assert found.reference.ortho.is_file() and found.reference.dsm.is_file()


@FUZZED
@given(anything(TRUTH))
@example(b"image,lat,lon,height\na," + b"9" * 400 + b",1,2\n")
@example(b'image,lat,lon,height\n"' + b"x" * 200_000 + b'",1,1,2\n')
@example(b"image,lat,lon,height,image\na,1,2,3,b\n")
@example(b"image,lat,lon,height\r\ra,1,2,3\r")
def test_truth_csv(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "truth.csv"
    path.write_bytes(raw)
    with suppress(InputError):
        truths = read_truth_csv(path)
        assert len({truth.image for truth in truths}) == len(truths) > 0
        for truth in truths:
            assert truth.image and abs(truth.lat) <= 90 and abs(truth.lon) <= 360 and math.isfinite(truth.height)


@FUZZED
@given(anything(CAMERAS))
@example(CAMERAS.replace(",0,REG", ",²,REG").encode())
@example(CAMERAS.replace(",0,REG", f",{'9' * 5000},REG").encode())
def test_cameras_csv(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "cameras.csv"
    path.write_bytes(raw)
    with suppress(InputError):
        read_cameras_csv(path)


@FUZZED
@given(st.text(max_size=60) | SPLINTERS.map("match.candidates={}".format) | SPLINTERS.map("{}=1".format))
def test_options_of_the_command_line(text: str) -> None:
    with suppress(InputError):
        with_options(Options(), dict([parse_option(text)]))


SUMMARY = summary_of_run(Path("run"), EnuFrame(47.0, 8.0, 500.0), 2, registered=True)
SUMMARY["reference"]["covariance_m2"] = np.eye(3).tolist()
SUMMARY["sets"][0]["components"][0]["scene_centre_enu"] = [0.0, 0.0, 0.0]


def finished(folder: Path) -> Path:
    (folder / "summary.json").write_text(json.dumps(SUMMARY))
    (folder / "cameras.csv").write_text(CAMERAS)
    (folder / "truth.csv").write_text("image,lat,lon,height\na.png,47.1,8.2,500\n")
    return folder


@FUZZED
@given(anything(json.dumps(SUMMARY)))
@example(b"[]")
@example(b"\xff")
@example(json.dumps({**SUMMARY, "enu_origin": {"lat": 10**400, "lon": 0, "height": 0}}).encode())
@example(b"[" * 100_000)
@example(json.dumps({**SUMMARY, "sets": None}).encode())
@example(json.dumps({**SUMMARY, "enu_origin": {"lat": 99, "lon": 0, "height": 0}}).encode())
@example(json.dumps(SUMMARY).replace("[0.0, 0.0, 0.0]", "[0.0]").encode())
@example(json.dumps(SUMMARY).replace("[1.0, 0.0, 0.0]", "[-1.0, 0.0, 0.0]").encode())
@example(json.dumps(SUMMARY).replace('"component": 0', '"component": []').encode())
def test_summary_of_a_run(tmp_path: Path, raw: bytes) -> None:
    run = finished(tmp_path)
    (run / "summary.json").write_bytes(raw)
    with suppress(InputError):
        evaluate(Evaluate(run=run, truth=run / "truth.csv"))


def test_what_is_fuzzed_is_valid(site: Path, tmp_path: Path) -> None:
    checks: list[Callable[[], object]] = [
        lambda: with_options(Options(), load_site(site / "full.toml").options),
        lambda: evaluate(Evaluate(run=finished(tmp_path), truth=tmp_path / "truth.csv")),
    ]
    (site / "full.toml").write_text(FULL)
    for check in checks:
        check()
    (tmp_path / "truth.csv").write_text(TRUTH)
    assert len(read_truth_csv(tmp_path / "truth.csv")) == 2 == len(read_cameras_csv(tmp_path / "cameras.csv"))


@pytest.mark.parametrize(
    "wrong",
    [
        {"enu_origin": {"lat": 91, "lon": 0, "height": 0}},
        {"reference": {"covariance_m2": [[1, 0, 0], [9, 1, 0], [0, 0, 1]]}},
        {"enu_origin": {"lat": 10**400, "lon": 0, "height": 0}},
        {"sets": [{"set": "airborne", "components": ["x"]}]},
        {"reference": {"covariance_m2": None, "ortho": 1}, "request": {"ortho_address": None}, "sets": [3]},
    ],
)
def test_a_run_with_values_of_the_wrong_kind_names_its_summary(wrong: dict[str, object], tmp_path: Path) -> None:
    run = finished(tmp_path)
    (run / "summary.json").write_text(json.dumps({**SUMMARY, **wrong}))
    for name in ("ortho.tif", "dsm.tif"):
        (run / name).write_bytes(b"")
    for read in (lambda: site_of_run(Result.read(run)), lambda: earlier_run(run)):
        with pytest.raises(InputError, match=r"summary\.json"):
            read()


@pytest.mark.parametrize("cell", ["1" * 200_000, '"' + "x" * 200_000 + '"'])
def test_a_line_of_control_without_end_is_a_line(cell: str, tmp_path: Path) -> None:
    (tmp_path / "bars.csv").write_text(f"point_a,point_b,length_m,sigma_m\na,b,{cell},1\n")
    with pytest.raises(InputError, match=r"bars\.csv, line 2") as error:
        read_control([tmp_path / "bars.csv"], Stated())
    assert len(str(error.value)) < 1000
