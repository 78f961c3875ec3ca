# SPDX-License-Identifier: Apache-2.0
"""A flight that is refused for a wrong flying height is registered once a person states the right one."""

from __future__ import annotations

import json
import shutil
import threading
from pathlib import Path
from urllib.parse import urlencode
from urllib.request import urlopen

import pytest

from skymoor.cli.main import main
from skymoor.simulate.site import Site
from support.asked import refused_run
from support.small_run import run, summary_of


@pytest.mark.e2e
def test_an_answer_bounds_the_search_and_the_result_says_so(
    small_site: Site, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(finished, out)
    # Half of the right one: the smaller the render, the less there is to search.
    wrong = ("--set", "match.min_height_m=36", "--set", "match.max_height_m=39")
    assert run(small_site.folder / "airborne.toml", out, *wrong) == 3
    assert f"skymoor ask {out}" in capsys.readouterr().out
    assert "skymoor ask" in (out / "report.html").read_text()
    (place, *_) = summary_of(finished)["sets"][0]["components"][0]["hypotheses"]
    north = str(-place["azimuth_deg"] % 360)  # where it is on the render
    assert main(["ask", str(out), "--height", "75", "--north", north, "--by", "Ada", "--quiet", "--json"]) == 0
    shown, summary = json.loads(capsys.readouterr().out), summary_of(out)
    assert summary["person"] == shown["person"] == json.loads((out / "answers.json").read_text())["answers"][0]
    assert summary["person"]["words"].startswith("north was given on the render and the flying height was given")
    assert "A person helped with airborne_0" in (out / "report.html").read_text()
    kept = {one["name"]: one["cached"] for one in summary["stages"]}
    assert all(kept[name] for name in ("photos", "reconstruct", "airborne-0.depths", "airborne-0.nadir", "reference"))
    assert not kept["airborne-0.search"]
    found = summary["sets"][0]["components"][0]["hypotheses"][0]
    assert found["east"] == pytest.approx(place["east"], abs=1.0) and found["north"] == pytest.approx(
        place["north"], abs=1.0
    )
    assert main(["ask", str(out), "--candidate", "1"]) == 2
    assert "everything is registered: there is nothing to ask" in capsys.readouterr().err


def test_an_answer_may_be_recorded_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = refused_run(tmp_path)
    assert main(["ask", str(out), "--candidate", "2", "--no-run", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)["answer"]
    assert answer == json.loads((out / "answers.json").read_text())["answers"][0]
    assert (answer["component"], answer["by"], answer["stated"]) == ("airborne_0", "", {"candidate": 2})
    assert main(["ask", str(out), "--candidate", "2"]) == 2  # of a version that did not record what was asked
    (line,) = capsys.readouterr().err.splitlines()
    assert "did not record how it was asked for" in line
    for wrong in (["--candidate", "9"], ["--near", "99", "1", "1"], ["--component", "x", "--height", "3"]):
        assert main(["ask", str(out), "--no-run", *wrong]) == 2
        (line,) = capsys.readouterr().err.splitlines()
    assert len(json.loads((out / "answers.json").read_text())["answers"]) == 1


def test_the_page_opens_and_its_answer_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = refused_run(tmp_path)
    posted: list[int] = []
    threads: list[threading.Thread] = []

    def post(address: str) -> None:
        form = urlencode({"component": "airborne_0", "height": "40"}).encode()
        with urlopen(f"{address}answer", form, timeout=30) as answer:
            posted.append(answer.status)

    def open_browser(address: str) -> None:
        threads.append(threading.Thread(target=post, args=(address,), daemon=True))
        threads[0].start()

    monkeypatch.setattr("webbrowser.open", open_browser)
    assert main(["ask", str(out), "--no-run", "--by", "Ada"]) == 0
    threads[0].join(30)
    assert posted == [200]
    shown = capsys.readouterr().out
    assert "http://127.0.0.1:" in shown and "answer there; stop with Ctrl+C" in shown
    (answer,) = json.loads((out / "answers.json").read_text())["answers"]
    assert (answer["by"], answer["stated"]) == ("Ada", {"height": 40.0})
