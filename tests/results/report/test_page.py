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
from skymoor.results.read import ComponentSummary, Result
from skymoor.results.report.page import report_page
from skymoor.results.report.survey import lens_parts, search_parts
from skymoor.results.report.words import facts
from support.finished import HOSTILE, finished_run

FORMER = {"summary", "verdict", "map", "photos", "swipe", "heights", "components", "files", "stages", "provenance"}
SECTIONS = FORMER | {"calibration", "block", "search", "glossary", "options"}
UNKNOWN = {"ce90_m": None, "le90_m": None}
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
    run = finished_run(tmp_path)
    page = Page(report_page(Result.read(run)))
    assert page.ids >= SECTIONS
    for tag, attributes in page.tags:
        for name in ("src", "href", "srcset", "action", "data", "poster"):
            address = attributes.get(name)
            linked = tag == "a" and address is not None and (run / address).exists()
            assert address is None or linked or address.startswith(("data:", "#")), (name, address)
    assert len(page.of("img")) == 5
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
    assert "No camera has a position: this is the reference." in text and "Ellipses hold" not in text
    assert {"map", "components"} <= page.ids
    assert not page.ids & {"swipe", "heights"}


def test_figures_that_are_not_known_are_left_out() -> None:
    figures = {"n_cameras": 12, "n_inliers": 0, "n_matches": 0, "rmse_m": None}
    refused = ComponentSummary("ground0", 0, registered=False, reason="", heights=None, **UNKNOWN, summary=figures)
    assert facts(refused) == [("cameras", "12"), ("inliers", "0 of 0 matches")]


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


def test_the_differences_in_height_are_numbers_too(tmp_path: Path) -> None:
    folder = finished_run(tmp_path)
    parts = Result.read(folder).statistics
    assert main(["report", str(folder)]) == 0
    found = json.loads((folder / "statistics.json").read_text())["height_difference"]
    assert 0.45 < found["median_m"] < 0.55 and 0 <= found["spread_m"] < found["reach_m"]
    assert 0.9 * found["n"] < sum(found["counts"]) <= found["n"]
    assert Result.read(folder).statistics == parts  # those of components alone, as before


def test_paper_shows_neither_hints_for_the_mouse_nor_all_options(tmp_path: Path) -> None:
    text = report_page(Result.read(finished_run(tmp_path)))
    on_paper = re.sub(r'<(span|details) class="screen">.*?</\1>', "", text, flags=re.DOTALL)
    assert "Drag to move" in text and "Every option" in text
    assert not re.search("Drag to move|Move the slider|Every option", on_paper)
    assert ",.screen{display:none}" in text.partition("@media print{")[2]


def test_the_summary_says_when_where_and_how_well(tmp_path: Path) -> None:
    result = Result.read(finished_run(tmp_path))
    found = result.summary["sets"][0]["components"][0]["statistics"]
    page = Page(report_page(result))
    text = re.sub(r"\s+", " ", " ".join(page.words))
    for told in (
        "2026-11-02 10:20:30 UTC",
        "WGS 84 / UTM zone 32N (EPSG:32632)",
        "height above the WGS 84 ellipsoid (EPSG:4979)",
        "EGM2008 height (EPSG:3855)",
        "9 of 10",
        "airborne 0: CE90 2.1 m, LE90 3.8 m",
        f"{found['area_m2']:.0f} m²",
        f"{100 * found['gsd_m']:.1f} cm",
        f"{found['mean_track_length']:.1f}",
        f"{found['mean_reprojection_px']:.2f} px (RMS {found['rms_reprojection_px']:.2f} px)",
        "Nine of ten cameras are expected within 2.1 m in plan and 3.8 m in height of the truth on Earth, and "
        "within 0.2 m in plan and 0.9 m in height of their place on the reference.",
    ):
        assert told in text, told


def test_a_lens_is_told_with_what_is_not_determined(tmp_path: Path) -> None:
    result = Result.read(finished_run(tmp_path))
    (lens,) = lens_parts(result)
    sigma = result.summary["sets"][0]["components"][0]["statistics"]["lenses"][0]["sigma"]
    rows = {name: (value, spread) for name, value, spread in lens.rows}
    assert rows["focal length x"] == ("392.00 px", f"{sigma['fx']:.2f} px")
    assert rows["radial distortion k1"][0] == "\N{MINUS SIGN}0.05000"
    assert rows["tangential distortion p1"] == ("0.00000", "not determined")
    assert "enlarged" in lens.words and lens.drawing.count("<path") > 20


def test_what_came_second_is_told_with_its_distance(tmp_path: Path) -> None:
    (part,) = search_parts(Result.read(finished_run(tmp_path)), 1, ortho=False)
    assert part.words == (
        "The whole reference was searched, 6400 m² with imagery. The best hypothesis, which was accepted, has a score "
        "of 90.0. The second has 65.0, 50 m from it."
    )
    assert part.drawing is not None and part.drawing.svg.count("<circle") == 2


def test_every_map_has_a_scale_and_north(tmp_path: Path) -> None:
    text = report_page(Result.read(finished_run(tmp_path)))
    maps = re.findall(r'<svg (?:class="plan"|id="chart").*?</svg>', text, re.DOTALL)
    assert len(maps) == 6  # cameras, overlap, match graph, search, surface, differences
    for one in maps:
        assert one.count('class="furniture"') == 1 and ">N</text>" in one and re.search(r">\d+ k?m</text>", one)
    assert 'class="bar-of-scale"' in text and 'class="north"' in text


def test_ellipses_are_those_of_the_covariance(tmp_path: Path) -> None:
    text = report_page(Result.read(finished_run(tmp_path)))
    ellipses = re.findall(
        r'<ellipse class="(\w+) c0" [^>]*rx="([\d.]+)" ry="([\d.]+)" transform="rotate\((-?[\d.]+)', text
    )
    # The run has variances of 0.9 m^2 east and 0.4 north, in ellipses for 8 of 9 cameras and a circle for the other.
    wanted = [("ce90", f"{2.146 * 0.9**0.5:.2f}", f"{2.146 * 0.4**0.5:.2f}", 0.0)] * 8
    found = [(css, f"{float(a):.2f}", f"{float(b):.2f}", float(turn)) for css, a, b, turn in ellipses if css == "ce90"]
    assert [one for one in found if one[1] != one[2]] == wanted and len(found) == 9
    relative = [(float(a), float(b)) for css, a, b, _ in ellipses if css == "relative"]
    times = re.search(r"without the error of the reference, drawn (\d+) times enlarged", text)
    assert times is not None and max(a for a, _ in relative) == pytest.approx(
        int(times[1]) * 2.146 * 0.02**0.5, rel=0.01
    )


def test_a_run_of_a_former_version_gets_its_report(tmp_path: Path) -> None:
    page = Page(report_page(Result.read(finished_run(tmp_path, former=True))))
    assert page.ids >= FORMER and not page.ids & {"calibration", "block"}
    assert len(page.of("ellipse")) == 18  # circles of CE90, on Earth and relative
    words = "".join(page.words)
    assert "EPSG" not in words.partition("Verdict")[0] and "skymoor 0.1.0" in words


def test_damaged_statistics_cost_no_report(tmp_path: Path) -> None:
    run = finished_run(tmp_path)
    (run / "statistics.json").write_text("[")
    assert Result.read(run).statistics == {}
    assert not Page(report_page(Result.read(run))).ids & {"block"}


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
