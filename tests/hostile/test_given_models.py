# SPDX-License-Identifier: Apache-2.0
"""`skymoor register` with what it cannot use: exit status 2, one line, and nothing is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skymoor.cli.main import main
from support.given_models import write_ply
from support.tiny_site import make_site


def nan_cloud(folder: Path) -> list[Path]:
    xyz = np.random.default_rng(0).uniform(0, 9, (900, 3))
    xyz[7] = np.nan
    return [write_ply(folder / "cloud.ply", xyz)]


def word_document(folder: Path) -> list[Path]:
    (folder / "model.docx").write_bytes(b"PK\3\4")
    return [folder / "model.docx"]


def nothing(folder: Path) -> list[Path]:
    return []


def the_reference_itself(folder: Path) -> list[Path]:
    return [folder / "site" / "dsm.tif"]


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (nan_cloud, "NaN"),
        (word_document, "is no model"),
        (nothing, "name the model"),
        (the_reference_itself, "one orthophoto"),
    ],
)
def test_one_line_and_status_2(make: object, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path / "site")
    model = [str(path) for path in make(tmp_path)]  # type: ignore[operator]
    reference = ["--ortho", str(site / "ortho.tif"), "--dsm", str(site / "dsm.tif"), "--vertical-datum", "ellipsoid"]
    out = tmp_path / "out"
    assert main(["register", *model, *reference, "--ce90", "2", "--le90", "3", "--out", str(out), "--quiet"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("skymoor: ") and says in lines[0]
    assert not out.exists()
