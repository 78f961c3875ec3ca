# SPDX-License-Identifier: Apache-2.0
"""What an answer means: bounds around the truth, no wider than its uncertainty, and a record of who said so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.pipeline.prior import prior_from_plain
from skymoor.results.ask.answer import Statement, answers_of, person_of, record_answer
from skymoor.results.ask.question import Question, cut_out, question_about, questions_of
from skymoor.results.read import Result
from skymoor.results.report.page import report_page
from skymoor.results.report.words import person_words
from skymoor.results.tables import CameraRow
from skymoor.store import Store
from support.asked import FIRST, PIXEL, refused_run


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return Result.read(refused_run(tmp_path_factory.mktemp("asked")))


@pytest.fixture
def question(result: Result) -> Question:
    (found,) = questions_of(result)  # ground photos are placed on the airborne model: no place of theirs is asked for
    return found


def half_sides(area: tuple[float, ...] | None, lat: float, lon: float) -> np.ndarray:
    """Metres from a point to the west, south, east and north of an area."""
    assert area is not None
    west, south, east, north = area
    corners = EnuFrame(lat, lon, 0.0).enu_from_lla([south, north], [west, east], [0, 0])[:, :2]
    return np.abs(corners).ravel()


def test_the_render_tells_how_large_the_model_is(question: Question) -> None:
    assert question.name == "airborne_0" and question.first_photo == FIRST
    render = question.render
    assert render is not None and render.pixel == pytest.approx(PIXEL)
    assert render.reach == pytest.approx(30 * PIXEL, abs=PIXEL)
    assert render.reach_from(10, 40) == pytest.approx(60 * PIXEL, abs=PIXEL)


def test_a_chosen_place_bounds_area_direction_and_height(result: Result, question: Question) -> None:
    person = person_of(result, question, Statement(candidate=2, by=" Ada "))
    place = question.places[1]
    sides = half_sides(person.prior.area, place.lat, place.lon)
    np.testing.assert_allclose(sides, 1.25 * 30 + 20, atol=2.0)  # the model, a quarter more, and 20 m
    heading = person.prior.heading
    assert heading is not None and (heading.image, heading.tolerance_deg) == (FIRST[0], 20.0)
    assert heading.degrees == pytest.approx(FIRST[1] + 60.0, abs=0.01)
    assert person.prior.height_m == pytest.approx(12.0)
    record = person.record
    assert (record["component"], record["by"], record["stated"]) == ("airborne_0", "Ada", {"candidate": 2})
    assert record["words"].startswith("place 2 was chosen: the search is bounded to latitude")
    assert "directions within 20 degrees and flying" not in record["words"]
    assert "directions within 20 degrees, flying heights of 10 to 15 m" in record["words"]
    assert prior_from_plain(json.loads(json.dumps(record["prior"]))) == person.prior


def test_one_point_holds_the_model_at_every_height(result: Result, question: Question) -> None:
    point = (10.0, 40.0, 48.001, 11.002)
    person = person_of(result, question, Statement(point=point))
    reach_m = 60 * PIXEL * 200.0 + 25.0  # match.max_height_m, and how far off a person points
    np.testing.assert_allclose(half_sides(person.prior.area, 48.001, 11.002), reach_m, rtol=0.03)
    nearer = person_of(result, question, Statement(point=point, height=40.0))
    np.testing.assert_allclose(half_sides(nearer.prior.area, 48.001, 11.002), 60 * PIXEL * 50.0 + 25.0, rtol=0.03)


def test_a_length_and_north_on_the_render(result: Result, question: Question) -> None:
    person = person_of(result, question, Statement(length=(10, 40, 40, 80, 75.0), north=350.0))
    assert person.prior.height_m == pytest.approx(75.0 / (50 * PIXEL))
    heading = person.prior.heading
    # North is 10 degrees left of the upper edge, so what looks 10 degrees right of it looks to 20.
    assert heading is not None and heading.degrees == pytest.approx(20.0)
    assert person.prior.area is None and person.record["height_factor"] == 1.25


def test_what_is_registered_beside_it_keeps_its_place(tmp_path: Path) -> None:
    result = Result.read(refused_run(tmp_path, registered_beside=True))
    row = CameraRow("x", "airborne", 1, "REGISTERED", 48.01, 11.0, 500.0, *(0.0,) * 7, 1.0, 1.0, 0.1, 0.1)
    result.__dict__["cameras"] = (row,)
    (question,) = questions_of(result)
    prior = person_of(result, question, Statement(candidate=1)).prior
    assert prior.area is not None and prior.area[3] > 48.01 + 199 / 111_000 and prior.area[1] < 48.0
    assert prior.height_m is None and prior.heading is not None


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        (Statement(by="x"), "nothing was stated"),
        (Statement(candidate=3), "candidate 3: give a number from 1 to 2"),
        (Statement(candidate=1, near=(48.0, 11.0, 10.0)), "candidate and near say the same thing twice"),
        (Statement(heading="20", north=3.0), "heading and north say the same"),
        (Statement(height=20, length=(1, 1, 2, 2, 3)), "height and length say the same"),
        (Statement(near=(95.0, 11.0, 10.0)), "near 95 11 10: give latitude"),
        (Statement(area=(9.0, 47.0, 8.0, 48.0)), "west below east"),
        (Statement(point=(90.0, 4.0, 48.0, 11.0)), "outside of the render, which has 80 by 80"),
        (Statement(length=(1, 1, 1, 1, 3)), "two different points"),
        (Statement(length=(1, 1, 2, 2, -3)), "two different points"),
        (Statement(length=(1, 1, 2, 2)), "length: give 5 numbers"),
        (Statement(north=1e9), "clockwise from the upper edge"),
        (Statement(near=(11.0, 48.0, 100.0)), "outside of the map"),
        (Statement(heading="north"), "degrees clockwise from north"),
        (Statement(height=-3), "flying height"),
    ],
)
def test_what_makes_no_sense_is_one_line(statement: Statement, words: str, result: Result, question: Question) -> None:
    with pytest.raises(InputError) as error:
        person_of(result, question, statement)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_a_run_that_recorded_no_directions_still_takes_a_place(result: Result, question: Question) -> None:
    older = replace(question, first_photo=None, render=None)
    prior = person_of(result, older, Statement(candidate=1)).prior
    assert prior.heading is None and prior.height_m == 12.0 and prior.area is not None
    with pytest.raises(InputError, match="give a heading instead"):
        person_of(result, older, Statement(north=3.0))


def test_a_cut_out_shows_the_map_as_the_render_would(result: Result, question: Question) -> None:
    assert question.render is not None
    plain = replace(question.places[0], east=0.0, north=0.0, azimuth_deg=0.0)
    upright = cut_out(result, question.render, plain)
    turned = cut_out(result, question.render, replace(plain, azimuth_deg=90.0))
    assert upright is not None and turned is not None and upright.shape == (80, 80, 3)
    # Turned clockwise by 90 degrees, the upper edge of the render is in the east: the map is seen turned back.
    inner = np.s_[15:-15, 15:-15]
    difference = np.abs(np.rot90(upright)[inner].astype(float) - turned[inner]).mean()
    assert difference < 3.0 < np.abs(upright[inner].astype(float) - turned[inner]).mean()


def test_answers_are_kept_in_their_order(tmp_path: Path) -> None:
    result = Result.read(refused_run(tmp_path))
    (question,) = questions_of(result)
    for height in (40.0, 50.0):
        with Store.open(result.folder) as store:
            record_answer(store, person_of(result, question, Statement(height=height)))
    found = answers_of(result.folder / "answers.json")
    assert [one["stated"]["height"] for one in found] == [40.0, 50.0]
    for damaged in ("{", "[" * 100_000):
        (result.folder / "answers.json").write_text(damaged)
        assert answers_of(result.folder / "answers.json") == []
    words = person_words({"person": found[1]})
    assert words.startswith("a person helped with airborne_0: the flying height was given") and person_words({}) == ""


def test_a_damaged_summary_is_one_line(tmp_path: Path) -> None:
    run = refused_run(tmp_path)
    summary = json.loads((run / "summary.json").read_text())
    for wrong in ({"hypotheses": [{}]}, {"hypotheses": 3}, {"hypotheses": [], "first_photo": {"image": "a"}}):
        summary["sets"][0]["components"][0].update(wrong)
        (run / "summary.json").write_text(json.dumps(summary))
        with pytest.raises(InputError, match=r"summary\.json: is damaged or of another version"):
            questions_of(Result.read(run))


def test_there_may_be_nothing_to_ask(tmp_path: Path, question: Question) -> None:
    run = refused_run(tmp_path)
    summary = json.loads((run / "summary.json").read_text())
    summary["sets"][0]["components"][0]["status"] = "REGISTERED"
    (run / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(InputError, match="the airborne components are registered"):
        questions_of(Result.read(run))
    summary["sets"] = summary["sets"][:1]
    (run / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(InputError, match="everything is registered"):
        questions_of(Result.read(run))
    with pytest.raises(InputError, match="give one of airborne_0"):
        question_about("airborne_7", [question])


def test_the_report_says_that_a_person_helped_and_that_one_may(tmp_path: Path) -> None:
    run = refused_run(tmp_path)
    page = report_page(Result.read(run))
    assert "<code>skymoor ask</code>" in page and "A person helped" not in page
    result = Result.read(run)
    record = person_of(result, questions_of(result)[0], Statement(height=40.0, by="<b>Ada</b>")).record
    page = report_page(replace(result, summary={**result.summary, "person": record}))
    assert "A person helped with airborne_0: the flying height was given: the search is bounded to" in page
    assert "flying heights of 32 to 50 m (&lt;b&gt;Ada&lt;/b&gt;)" in page
