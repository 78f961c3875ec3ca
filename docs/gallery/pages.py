# SPDX-License-Identifier: Apache-2.0
"""Pictures of pages: the report at a desk, on a phone and as it is printed, and the page of `skymoor ask`."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from PIL import Image

from gallery.browser import tab
from gallery.run import Missing, Source, saved
from skymoor.results.ask.question import questions_of
from skymoor.results.ask.server import AskServer
from skymoor.results.read import Result
from skymoor.results.report.page import report_page
from skymoor.results.report.pdf import print_report
from skymoor.results.report.write import PAGE

DESK, PHONE = (1180, 900), (390, 844)  # CSS pixels
SHEETS = ("-png", "-r", "60", "-f", "1", "-l", "3")
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
    saved(beside(shots), path, 1100)


def report_print(source: Source, path: Path) -> None:
    """The first sheets of report.pdf. Raises `Missing` without pdftoppm, which draws them."""
    program = shutil.which("pdftoppm")
    if program is None:
        raise Missing("there is no pdftoppm (Debian: apt-get install poppler-utils)")
    folder = source.scratch / "print"
    folder.mkdir(exist_ok=True)
    (folder / PAGE).write_text(report_page(source.result), encoding="utf-8")
    subprocess.run([program, *SHEETS, str(print_report(folder)), str(folder / "sheet")], check=True)
    saved(beside([Image.open(one).convert("RGB") for one in sorted(folder.glob("sheet*.png"))]), path, 1300)


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


def beside(pictures: list[Image.Image]) -> Image.Image:
    """One picture of all, from left to right."""
    width = sum(one.width for one in pictures) + GAP * (len(pictures) - 1)
    canvas = Image.new("RGB", (width, max(one.height for one in pictures)), (200, 200, 200))
    left = 0
    for one in pictures:
        canvas.paste(one, (left, 0))
        left += one.width + GAP
    return canvas
