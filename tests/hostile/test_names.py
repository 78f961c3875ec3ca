# SPDX-License-Identifier: Apache-2.0
"""Names of photos and sites that look like markup, scripts, cells or formulas: pages and files take them for names."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from skymoor.errors import InputError
from skymoor.results.ask.page import AskPage
from skymoor.results.ask.question import questions_of
from skymoor.results.export import export
from skymoor.results.read import Result
from skymoor.results.report.page import report_page
from skymoor.results.tables import CAMERA_COLUMNS, CameraRow, read_camera_rows
from skymoor.results.viewer.cameras import words_of
from skymoor.results.viewer.scene import Frustum
from skymoor.store import find_photos
from support import exported_run
from support.asked import refused_run
from support.finished import finished_run
from support.tiny_site import picture

NAMES = (
    "air</script><script>alert(1)</script>.jpg",
    "air/<img src=x onerror=alert(1)>\"'`.jpg",
    "air/\u202egpj.\u2066exe {alert(1)} ${1} [x](javascript:1).jpg",
    "=HYPERLINK(1)/@SUM(1).jpg",
    "-1+1/&lt;b&gt; %3Cb%3E \\u003c.jpg",
)


class Structure(HTMLParser):
    """Elements, and the names of their attributes, in their order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, tuple[str, ...]]] = []
        self.words: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, tuple(name for name, _ in attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def renamed(value: Any, names: dict[str, str]) -> Any:
    if isinstance(value, dict):
        return {names.get(key, key): renamed(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [renamed(item, names) for item in value]
    return names.get(value, value) if isinstance(value, str) else value


def with_hostile_names(run: Path) -> Path:
    """The run with other names of its photos, wherever it has them, and of its site."""
    rows = read_camera_rows(run / "cameras.csv")
    names = {row.image: hostile for row, hostile in zip(rows, NAMES, strict=False)}
    with (run / "cameras.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, CAMERA_COLUMNS)
        writer.writeheader()
        writer.writerows([vars(replace(row, image=names.get(row.image, row.image))) for row in rows])
    for path in run.glob("*.json"):
        content = renamed(json.loads(path.read_text(encoding="utf-8")), names)
        if path.name == "summary.json":
            content["site"] = NAMES[0]
        path.write_text(json.dumps(content), encoding="utf-8")
    return run


def asking(run: Path) -> str:
    result = Result.read(run)
    return AskPage(result, questions_of(result)).asking().decode()


@pytest.mark.parametrize(
    ("make", "page"), [(finished_run, lambda run: report_page(Result.read(run))), (refused_run, asking)]
)
def test_a_page_has_the_same_elements_whatever_the_names(
    make: Callable[[Path], Path], page: Callable[[Path], str], tmp_path: Path
) -> None:
    run = make(tmp_path)
    before = Structure(page(run))
    after = Structure(page(with_hostile_names(run)))
    assert after.found == before.found
    assert not any(name.startswith("on") for _, names in after.found for name in names)
    assert any(NAMES[0] in words for words in after.words)


def test_the_viewer_has_no_markup_of_a_name() -> None:
    for name in NAMES:
        row = CameraRow(name, name, 0, "REGISTERED", *[1.0] * 14)
        words = words_of(Frustum(row, None, None, 1.0, 1.0))  # type: ignore[arg-type]
        assert not set("<>{}[]`\"'=$") & set(words)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run of photos whose names are hostile as far as a file's can be, all in one folder."""
    whole = exported_run.cameras()
    called = [f"air/{name.rpartition('/')[2]}" for name in NAMES]
    hostile = tuple(replace(one, image=name) for one, name in zip(whole, called, strict=True))
    monkeypatch.setattr(exported_run, "cameras", lambda: hostile)
    folder = exported_run.write_run(tmp_path)
    rows = [row for row in read_camera_rows(folder / "cameras.csv") if row.lat is not None]
    assert [row.image for row in rows] == called[:4]
    return folder


def test_files_give_the_names_back(run: Path, tmp_path: Path) -> None:
    expected = {row.image for row in Result.read(run).registered_cameras}
    export(Result.read(run), ["geojson,kml,stac,nerfstudio,colmap,gpkg"], tmp_path / "out", lambda _: None)
    points = json.loads((tmp_path / "out/geojson/cameras.geojson").read_text(encoding="utf-8"))["features"]
    assert {one["properties"]["image"] for one in points} == expected
    marks = ET.parse(tmp_path / "out/kml/cameras.kml").iter("{http://www.opengis.net/kml/2.2}Placemark")
    assert {mark.findtext("{http://www.opengis.net/kml/2.2}name") for mark in marks} == expected
    for path in (tmp_path / "out").rglob("*.json"):
        json.loads(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ["metashape", "realityscan"])
def test_a_table_without_quotation_marks_refuses_names_that_need_them(run: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="rename the photo"):
        export(Result.read(run), [name], tmp_path / "out", lambda _: None)
    assert not (tmp_path / "out" / name).exists()


@pytest.mark.parametrize("letter", ["\n", "\u2028", "\uffff", "\x1b"])
def test_a_name_that_is_no_line_of_text_is_told(letter: str, tmp_path: Path) -> None:
    from PIL import Image

    for name in ("1", "2", f"a{letter}b"):
        Image.fromarray(picture()).save(tmp_path / f"{name}.png")
    with pytest.raises(InputError, match="rename it"):
        find_photos([tmp_path], tmp_path)
