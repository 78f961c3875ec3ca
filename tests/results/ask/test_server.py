# SPDX-License-Identifier: Apache-2.0
"""The page answers its own address alone, takes one answer, and says in one line what is wrong with another."""

from __future__ import annotations

from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlencode

import pytest

from skymoor.errors import InputError
from skymoor.results.ask.question import questions_of
from skymoor.results.ask.server import AskServer, statement_of
from skymoor.results.read import Result
from support.asked import refused_run


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return Result.read(refused_run(tmp_path_factory.mktemp("asked")))


@pytest.fixture
def server(result: Result) -> Iterator[AskServer]:
    with AskServer(result, questions_of(result), by="Ada") as running:
        yield running


def ask(server: AskServer, path: str, form: dict[str, str] | str | None = None, **headers: str) -> tuple[int, str]:
    connection = HTTPConnection("127.0.0.1", server.port, timeout=20)
    body = urlencode(form) if isinstance(form, dict) else form
    connection.request("GET" if form is None else "POST", path, body, headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    if answer.status == 200:
        assert "default-src 'none'" in (answer.getheader("Content-Security-Policy") or "")
        assert answer.getheader("Cache-Control") == "no-store"
    connection.close()
    return answer.status, text


def test_the_page_shows_the_places_and_loads_nothing(server: AskServer) -> None:
    status, text = ask(server, f"/{server.token}/")
    assert status == 200 and "Place 2" in text and "competing hypothesis" in text
    assert "<script>alert" not in text and "http://" not in text and "https://" not in text
    assert text.count("data:image/jpeg") >= 4  # the render twice, two places, and the map
    assert 'value="airborne_0"' in text and 'value="ground0_0"' not in text


@pytest.mark.parametrize("form", [None, {"component": "airborne_0", "candidate": "1"}])
def test_only_its_own_address_is_answered(server: AskServer, form: dict[str, str] | None) -> None:
    page = f"/{server.token}/" + ("answer" if form else "")
    assert ask(server, page, form, Host="evil.example")[0] == 403
    assert ask(server, page, form, Host=f"127.0.0.1.evil.example:{server.port}")[0] == 403
    for path in ("/", "/answer", f"/{server.token}", page.replace(server.token, server.token[:-1] + "!"), f"{page}x"):
        status, text = ask(server, path, form)
        assert status == 404 and server.token not in text
    assert server.answer is None
    assert ask(server, page, form, Host=f"localhost:{server.port}")[0] == 200


def test_the_first_answer_counts(server: AskServer) -> None:
    status, text = ask(server, f"/{server.token}/answer", {"component": "airborne_0", "candidate": "2", "near_lat": ""})
    assert status == 200 and "place 2 was chosen" in text
    ask(server, f"/{server.token}/answer", {"component": "airborne_0", "height": "40"})
    person = server.wait()
    assert person.record["stated"] == {"candidate": 2} and person.record["by"] == "Ada"


@pytest.mark.parametrize(
    ("form", "words"),
    [
        ({"component": "airborne_0"}, "nothing was stated"),
        ({"component": "airborne_9", "candidate": "1"}, "no question about component &#39;airborne_9&#39;"),
        ({"component": "airborne_0", "candidate": "x"}, "candidate &#39;x&#39;: give a number"),
        ({"component": "airborne_0", "candidate": "7"}, "give a number from 1 to 2"),
        ({"component": "airborne_0", "area_west": "8"}, "area: fill in all of west, south, east, north"),
        ({"component": "airborne_0", "height": "<b>"}, "height &#39;&lt;b&gt;&#39;: give a number"),
        ({"component": "airborne_0", "height": "nan"}, "flying height"),
        ({}, "no question about component"),
    ],
)
def test_a_wrong_answer_is_one_line_and_can_be_given_again(form: dict[str, str], words: str, server: AskServer) -> None:
    status, text = ask(server, f"/{server.token}/answer", form)
    assert status == 400 and server.answer is None
    alert = text.partition('role="alert"')[2].partition("</p>")[0]
    assert words in alert and "\n" not in alert
    assert ask(server, f"/{server.token}/answer", {"component": "airborne_0", "height": "1,5"})[0] == 200


def test_bodies_that_no_page_sends_are_refused(server: AskServer) -> None:
    page = f"/{server.token}/answer"
    assert ask(server, page, "a=" + 30_000 * "x")[0] == 413
    assert ask(server, page, "&".join(f"a{k}=1" for k in range(99)))[0] == 400
    assert ask(server, page, "a=1", **{"Content-Length": "x"})[0] == 413
    assert server.answer is None


def test_ports(result: Result, server: AskServer) -> None:
    questions = questions_of(result)
    with pytest.raises(InputError, match="65535"):
        AskServer(result, questions, 99999)
    with pytest.raises(InputError, match=f"--port {server.port}: "):
        AskServer(result, questions, server.port)


def test_all_fields_are_read() -> None:
    form = {"near_lat": "47.1", "near_lon": " 8,5 ", "near_radius": "300", "heading": " a.jpg=30 ", "by": "Ada"}
    found = statement_of(
        form | {"north": "-4", "length_u0": "1"} | {f"length_{n}": "2" for n in ("v0", "u1", "v1", "m")}
    )
    assert found.near == (47.1, 8.5, 300.0) and found.heading == "a.jpg=30" and found.north == -4.0
    assert found.length == (1.0, 2.0, 2.0, 2.0, 2.0) and found.point is None and found.candidate is None


def test_the_folder_of_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"summary\.json"):
        Result.read(tmp_path)
