# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest

from skymoor.errors import InputError
from skymoor.evaluate import Estimate, Truth
from skymoor.results.tables import read_cameras_csv, read_truth_csv

HEADER = "image,set,component,status,lat,lon,height,east,north,up,qw,qx,qy,qz,ce90,le90\n"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_reads_truth(tmp_path: Path) -> None:
    path = write(tmp_path, '\ufeffimage, lat,lon,height,note\n"air/a, 1.jpg",46.5,-7.25,500,x\nair\\b.jpg,1e-3,0,-3,\n')
    assert read_truth_csv(path) == [Truth("air/a, 1.jpg", 46.5, -7.25, 500.0), Truth("air/b.jpg", 0.001, 0.0, -3.0)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("image,lat,height\na,1,2\n", "column lon is missing"),
        ("", "column image is missing"),
        ("image,lat,lon,height\n", "lists no images"),
        ("image,lat,lon,height\na,1,2,3\na,1,2,3\n", "line 3: the image a was listed before"),
        ("image,lat,lon,height\na,x,2,3\n", "line 2: lat = 'x' is not a number"),
        ("image,lat,lon,height\na,91,2,3\n", "line 2: lat = 91 is out of range"),
        ("image,lat,lon,height\na,1,nan,3\n", "line 2: lon = nan is out of range"),
        ("image,lat,lon,height\na,1,2\n", "line 2: has fewer cells"),
        ("image,lat,lon,height\na,1,2,3,4\n", "line 2: has more cells"),
        ("image,lat,lon,height\n,1,2,3\n", "line 2: the image has no name"),
        ('image,lat,lon,height\n"a,1,2,3\n', "cannot be read as a table"),
    ],
)
def test_bad_truth(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_truth_csv(write(tmp_path, text))
    assert "table.csv" in str(caught.value)


def test_truth_that_is_no_text_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_truth_csv(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x00")
    for path in (tmp_path, tmp_path / "binary.csv"):
        with pytest.raises(InputError, match="cannot be read"):
            read_truth_csv(path)


def test_reads_cameras(tmp_path: Path) -> None:
    rows = "a.jpg,airborne,0,REGISTERED,1,2,3,4,5,6,1,0,0,0,0.5,0.6\nb.jpg,airborne,,NOT_REGISTERED,,,,,,,,,,,,\n"
    assert read_cameras_csv(write(tmp_path, HEADER + rows)) == [
        Estimate("a.jpg", "airborne", 0, True, 1.0, 2.0, 3.0, 0.5, 0.6),
        Estimate("b.jpg", "airborne", None, False),
    ]


@pytest.mark.parametrize(
    ("row", "message"),
    [("a,air,0,MAYBE,,,,,,,,,,,,", "status 'MAYBE'"), ("a,air,x,REGISTERED,,,,,,,,,,,,", "component 'x'")],
)
def test_bad_cameras(tmp_path: Path, row: str, message: str) -> None:
    with pytest.raises(InputError, match=f"line 2: {message}"):
        read_cameras_csv(write(tmp_path, HEADER + row + "\n"))
