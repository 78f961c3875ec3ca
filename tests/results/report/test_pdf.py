# SPDX-License-Identifier: Apache-2.0
"""report.pdf is what a browser prints; without one, the line says what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from skymoor.errors import BackendUnavailable, SkymoorError
from skymoor.results.report import pdf
from support.browser import needs_chromium

PAGE = "<!doctype html><title>t</title><h1>Report</h1><p style='break-before:page'>second page</p>"


@needs_chromium
def test_the_page_is_printed_beside_itself(tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text(PAGE)
    printed = pdf.print_report(tmp_path)
    content = printed.read_bytes()
    assert printed == tmp_path / "report.pdf" and content.startswith(b"%PDF-") and content.rstrip().endswith(b"%%EOF")
    assert content.count(b"/Type /Page\n") == 2 or b"/Count 2" in content
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "report.pdf"]


def test_without_a_browser_the_remedy_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CHROMIUM", raising=False)
    monkeypatch.setattr("shutil.which", lambda _: None)
    with pytest.raises(BackendUnavailable, match="install one"):
        pdf.print_report(tmp_path)


def test_a_browser_that_prints_nothing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CHROMIUM", "/bin/true")
    (tmp_path / "report.html").write_text(PAGE)
    with pytest.raises(SkymoorError, match="/bin/true: does not print"):
        pdf.print_report(tmp_path)
    assert not (tmp_path / "report.pdf").exists()
