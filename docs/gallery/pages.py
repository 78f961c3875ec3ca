# SPDX-License-Identifier: Apache-2.0
"""Pictures of pages: the report at a desk, on a phone and as it is printed, and the page of `skymoor ask`."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from gallery.browser import tab
from gallery.run import Missing, Source, saved
from skymoor.results.ask.question import questions_of
from skymoor.results.ask.server import AskServer
from skymoor.results.read import Result
from skymoor.results.report.page import report_page

DESK, PHONE, SHEET = (1180, 900), (390, 844), (718, 1015)  # CSS pixels; the last is A4 within its margins
GAP = 24


def _address(source: Source) -> str:
    """The report as this version writes it."""
    path = source.folder / "gallery-report.html"
    path.write_text(report_page(source.result), encoding="utf-8")
    return path.resolve().as_uri()


def report(source: Source, path: Path) -> None:
    """From the top to the map of the cameras."""
    address = _address(source)
    with tab() as page:
        page.resize(*DESK)
        page.open(address)
        end = page.run("document.querySelector('#map figure, #map').getBoundingClientRect().bottom + scrollY + 10")
        page.resize(DESK[0], int(end))
        saved(page.picture(), path, 900)
    Path(address[len("file://") :]).unlink()


def report_phone(source: Source, path: Path) -> None:
    """The verdict, the map and a table of the report on a phone, beside each other."""
    address = _address(source)
    with tab() as page:
        page.resize(*PHONE, scale=1.5, phone=True)
        page.open(address)
        shots = []
        for section in ("verdict", "map", "photos"):
            page.run(f"document.getElementById('{section}').scrollIntoView({{behavior: 'instant'}})")
            shots.append(page.picture())
    Path(address[len("file://") :]).unlink()
    saved(_beside(shots), path, 1100)


def report_print(source: Source, path: Path) -> None:
    """The first sheets as the report is printed."""
    address = _address(source)
    with tab() as page:
        page.send("Emulation.setEmulatedMedia", media="print")
        page.resize(SHEET[0], 3 * SHEET[1])
        page.open(address)
        page.run("dispatchEvent(new Event('beforeprint'))")
        long = page.picture()
    Path(address[len("file://") :]).unlink()
    saved(_beside([long.crop((0, k * SHEET[1], SHEET[0], (k + 1) * SHEET[1])) for k in range(3)]), path, 1300)


def ask(source: Source, path: Path) -> None:
    """The page of `skymoor ask` about the same site, refused by an unreachable limit."""
    result = Result.read(source.refused)
    questions = questions_of(result)
    if not questions:
        raise Missing("nothing of the run was refused")
    with AskServer(result, questions) as server, tab() as page:
        page.resize(1200, 1330)
        page.open(server.address)
        saved(page.picture(), path, 1000)


def _beside(pictures: list[Image.Image]) -> Image.Image:
    width = sum(one.width for one in pictures) + GAP * (len(pictures) - 1)
    canvas = Image.new("RGB", (width, max(one.height for one in pictures)), (200, 200, 200))
    left = 0
    for one in pictures:
        canvas.paste(one, (left, 0))
        left += one.width + GAP
    return canvas
