# SPDX-License-Identifier: Apache-2.0
"""The page about a run, as text."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import pytest

from skymoor.cli.main import main
from skymoor.registration.criterion_kinds import KINDS
from skymoor.results.read import Result
from skymoor.results.report.page import report_page
from support.finished import HOSTILE, finished_run

SECTIONS = {"verdict", "map", "swipe", "heights", "components", "stages", "provenance"}
AA = 4.5  # WCAG 2, small text


class Page(HTMLParser):
    """What a browser would find in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]

    @property
    def ids(self) -> set[str | None]:
        return {attributes.get("id") for _, attributes in self.tags}


def test_it_needs_nothing_but_itself(tmp_path: Path) -> None:
    page = Page(report_page(Result.read(finished_run(tmp_path))))
    assert page.ids >= SECTIONS
    for _, attributes in page.tags:
        for name in ("src", "href", "srcset", "action", "data", "poster"):
            address = attributes.get(name)
            assert address is None or address.startswith(("data:", "#")), (name, address)
    assert len(page.of("img")) == 6
    assert all(image["alt"] and (image["src"] or "").startswith("data:image/") for image in page.of("img"))
    style = (files("skymoor.results.report") / "page.css").read_text(encoding="utf-8")
    assert "url(" not in style and "@import" not in style


def test_it_can_be_heard_and_walked_through_by_keys(tmp_path: Path) -> None:
    page = Page(report_page(Result.read(finished_run(tmp_path))))
    assert page.of("html")[0]["lang"] == "en"
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(b <= a + 1 for a, b in pairwise(levels)), levels
    assert all(head.get("scope") in ("col", "row") for head in page.of("th"))
    assert all(drawing.get("aria-label") for drawing in page.of("svg"))
    assert any(field.get("type") == "range" and field.get("aria-label") for field in page.of("input"))


def test_names_are_words_and_not_markup(tmp_path: Path) -> None:
    page = Page(report_page(Result.read(finished_run(tmp_path))))
    assert HOSTILE in page.words
    assert "air/<b>ä & 駅.jpg" in page.words
    assert len(page.of("script")) == 1
    assert not page.of("b") or all("ä" not in (one.get("data-name") or "") for one in page.of("b"))


def test_each_component_is_told_with_what_to_do(tmp_path: Path) -> None:
    text = "".join(Page(report_page(Result.read(finished_run(tmp_path)))).words)
    assert "Expected accuracy (90 %): 2.1 m horizontal (CE90), 3.8 m vertical (LE90)." in text
    assert "Refused: no wall fits." in text
    assert text.count("Remedy.") == 3
    assert "Nothing was reconstructed: no two photos agree" in text


def test_a_run_without_any_place_is_told_too(tmp_path: Path) -> None:
    page = Page(report_page(Result.read(finished_run(tmp_path, registered=False))))
    text = "".join(page.words)
    assert KINDS["competing_score"].remedy in text and KINDS["competing_score"].meaning in text
    assert "110.5" in text
    assert {"map", "components"} <= page.ids
    assert not page.ids & {"swipe", "heights"}


def test_it_is_written_when_the_reference_has_gone(tmp_path: Path) -> None:
    run = finished_run(tmp_path)
    (tmp_path / "dsm.tif").unlink()
    page = Page(report_page(Result.read(run)))
    assert "dsm.tif: the reference is not where the run found it" in "".join(page.words)
    assert "chart" in page.ids and "swipe" not in page.ids


def test_heights_are_compared_where_both_are_known(tmp_path: Path) -> None:
    text = "".join(Page(report_page(Result.read(finished_run(tmp_path)))).words)
    found = re.search(r"Model minus reference median \+(0\.\d+) m", re.sub(r"\s+", " ", text))
    assert found is not None
    assert 0.45 < float(found[1]) < 0.55  # half a metre was put in


def test_hundreds_of_cameras_stay_a_small_page(tmp_path: Path) -> None:
    text = report_page(Result.read(finished_run(tmp_path, cameras=400)))
    assert len(text) < 1_500_000
    assert text.count('class="dot') == 400


def test_report_writes_it_with_the_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = finished_run(tmp_path)
    row = {"set": "airborne", "component": 0, "n_cameras": 9, "mean_absolute_m": 1.25, "share_within_ce90": 0.5}
    (run / "evaluation.json").write_text(json.dumps({"rows": [row]}))
    assert main(["report", str(run)]) == 0
    assert "report.html" in capsys.readouterr().out
    page = Page((run / "report.html").read_text(encoding="utf-8"))
    assert "errors" in page.ids
    assert {"1.25", "50%"} <= set(page.words)


def test_report_of_no_run_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path)]) == 2
    assert "run skymoor run first" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def _luminance(colour: str) -> float:
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_letters_stand_out_by_day_by_night_and_in_print() -> None:
    style = (files("skymoor.results.report") / "page.css").read_text(encoding="utf-8")
    palettes = [
        dict(re.findall(r"--([a-z-]+):(#[0-9a-f]{6})", block)) for block in re.findall(r":root\{(.*?)\}", style)
    ]
    assert len(palettes) == 3
    pairs = [(ink, paper) for ink in ("ink", "quiet", "link", "good", "bad") for paper in ("paper", "card")]
    for palette in palettes:
        for ink, paper in [*pairs, ("good", "good-bg"), ("bad", "bad-bg")]:
            bright, dark = sorted((_luminance(palette[ink]), _luminance(palette[paper])), reverse=True)
            assert (bright + 0.05) / (dark + 0.05) >= AA, (ink, paper)
