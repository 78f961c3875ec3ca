# SPDX-License-Identifier: Apache-2.0
"""The notebook of the documentation, run from its first cell to its last."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import nbclient
import nbformat
import pytest

from support.examples import EXAMPLES

FIGURES = "plan_error_m, height_error_m, error_plan.max(), enu_from_level.scale, match.false_alarm_probability"


def outputs(book: Any, cell: int) -> list[Any]:
    """What a code cell left, by its number from the end."""
    return [one for one in book.cells if one.cell_type == "code"][cell].outputs


def test_two_rasters(tmp_path: Path) -> None:
    book = nbformat.read(EXAMPLES / "two_rasters.ipynb", as_version=4)
    nbformat.validate(book)
    assert not any(cell.get("outputs") for cell in book.cells), "clear the outputs before the notebook is committed"
    book.cells.append(nbformat.v4.new_code_cell(f"import json\nprint(json.dumps([float(x) for x in ({FIGURES})]))"))
    client = nbclient.NotebookClient(book, timeout=300, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    plan_m, height_m, worst_m, unit_m, chance = json.loads(outputs(book, -1)[0].text)
    # The model's pixel is 0.3 m, and the reference's 0.5 m with 0.3 m of noise in its heights: no error would be wrong.
    assert 0.005 < plan_m < 0.4 and plan_m < worst_m < 0.8
    assert 0.0005 < height_m < 0.3
    assert unit_m == pytest.approx(3.7, rel=0.005) and unit_m != 3.7
    assert chance < 1e-3
    assert "image/png" in outputs(book, -2)[0].data
