# SPDX-License-Identifier: Apache-2.0
"""Licence and credit of the reference go along with its results."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from skymoor.results.export import export
from skymoor.results.read import Result
from skymoor.results.report.write import rewrite_report
from skymoor.store import Store
from support.small_run import summary_of

STATED = {"licence": "CC-BY-4.0", "credit": "Survey <of> Nowhere", "ortho_source": "https://a.org/ortho.tif"}


@pytest.mark.e2e
def test_report_and_exports_name_them(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run, ignore=shutil.ignore_patterns("stages", ".lock"))
    summary = summary_of(run)
    assert {summary["reference"][key] for key in STATED} == {None}
    export(Result.read(run), ["geojson"], tmp_path / "before", lambda note: None)
    assert "reference" not in json.loads((tmp_path / "before" / "geojson" / "export.json").read_text())
    summary["reference"] |= STATED
    (run / "summary.json").write_text(json.dumps(summary))
    export(Result.read(run), ["geojson"], tmp_path / "out", lambda note: None)
    assert json.loads((tmp_path / "out" / "geojson" / "export.json").read_text())["reference"] == STATED
    with Store.open(run) as store:
        page = rewrite_report(Result.read(run), store).read_text()
    assert "Licence: CC-BY-4.0" in page and "Credit: Survey &lt;of&gt; Nowhere" in page
    assert "Orthophoto from: https://a.org/ortho.tif" in page and "DSM from" not in page
