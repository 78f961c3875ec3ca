# SPDX-License-Identifier: Apache-2.0
"""The pictures of the documentation: each is known, small, and made by a script or said not to be."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parent.parent / "docs"
LARGEST_SUM = 2_000_000  # bytes


def test_every_picture_is_made_or_named_as_made_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("websockets", reason="websockets is not installed: pip install skymoor[view]")
    monkeypatch.setattr(sys, "path", [str(DOCS), *sys.path])
    from gallery.__main__ import PICTURES

    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    by_hand = page.partition("## Other pictures")[2]
    there = {path.name for path in (DOCS / "images").iterdir()}
    assert set(PICTURES) <= there
    assert all(f"`{name}`" in page for name in there)
    assert {name for name in there if f"`{name}`" in by_hand} - {"overview.jpg"} == there - set(PICTURES)
    assert sum(path.stat().st_size for path in (DOCS / "images").iterdir()) < LARGEST_SUM


def test_a_frame_is_what_a_terminal_showed_before_its_bars_were_cleared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(DOCS), *sys.path])
    from gallery.terminal import frames_of

    shown = "a: 3 done\r\nall steps 10 %\r\nb: 1 of 9\r\x1b[2K\x1b[1A\x1b[2K"
    shown += "b: 9 done\r\nall steps \x1b[31m50 %\r\x1b[2K"
    frames = frames_of(shown)
    assert frames[0] == ["a: 3 done", "all steps 10 %", "b: 1 of 9"]
    assert frames[-1] == ["a: 3 done", "b: 9 done", "all steps \x1b[31m50 %"]


def test_the_picture_of_the_terminal_loads_nothing() -> None:
    text = (DOCS / "images" / "terminal.svg").read_text(encoding="utf-8")
    assert "all steps" in text.replace("&#160;", " ")
    assert "url(http" not in text and "href" not in text and "@import" not in text
