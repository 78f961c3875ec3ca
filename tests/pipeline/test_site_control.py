# SPDX-License-Identifier: Apache-2.0
"""Files of control are read as their programs write them, and what is wrong with them is one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from skymoor.control import Control, resolved
from skymoor.errors import InputError
from skymoor.geo.accuracy import CE90_PER_SIGMA, LE90_PER_SIGMA
from skymoor.pipeline.control_files import read_control
from skymoor.pipeline.control_places import Stated
from skymoor.pipeline.site import load_site
from skymoor.pipeline.site_control import control_from_plain, control_with_arguments, plain_control
from skymoor.store import plain
from support.tiny_site import SITE, make_site

STATED = Stated(None, "ellipsoid", 0.05, 0.08)
UTM = """WGS84 UTM 32N
500000.0 5300000.0 432.5 99.5 199.5 a.jpg north extra
500000.0 5300000.0 432.5 10 20 b.jpg north
500100.0 5300050.0 NaN 30 40 a.jpg east
"""
GEO = "EPSG:4326\na.jpg 9.0 47.8 500.0 10 0 0 0.02 0.04\nb.jpg 9.001 47.8\n"
POINTS = "point,image,px,py,lat,lon,height,sigma_h,sigma_v\nP,a.jpg,1.5,2.5,47.8,9.0,500,0.01,0.02\nP,b.jpg,3,4,,,,,\n"
ENDS = "point,image,px,py\nA,a.jpg,1,2\nA,b.jpg,3,4\nB,a.jpg,5,6\n"
BARS = "point_a,point_b,length_m,sigma_m\nA,B,12.5,0.002\n"
POSITIONS = "image,lat,lon,height,ce90,le90\na.jpg,47.8,9.0,500,0.03,0.05\n"


def given(folder: Path, *texts: str, stated: Stated = STATED) -> Control:
    files = []
    for k, text in enumerate(texts):
        files.append(folder / f"{k}.txt")
        files[-1].write_text(text, encoding="utf-8")
    return read_control(files, stated)


def test_gcp_list(tmp_path: Path) -> None:
    north, east = given(tmp_path, UTM).points
    assert (north.name, east.name) == ("north", "east") and north.place is not None and east.place is not None
    # ODM's first pixel has its centre at (0, 0), and ours at (0.5, 0.5).
    assert [(one.image, one.u, one.v) for one in north.marks] == [("a.jpg", 100.0, 200.0), ("b.jpg", 10.5, 20.5)]
    lon, lat = Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True).transform(500000.0, 5300000.0)
    assert (north.place.lon, north.place.lat, north.place.height) == pytest.approx((lon, lat, 432.5))
    assert north.place.sigma_h == pytest.approx(0.05 / CE90_PER_SIGMA)
    assert north.place.sigma_v == pytest.approx(0.08 / LE90_PER_SIGMA)
    assert np.isnan(east.place.height) and np.isnan(east.place.sigma_v)
    assert north.marks[1].where.endswith("0.txt, line 3")


@pytest.mark.parametrize("header", ["EPSG:32632", "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs", "wgs84 utm 32n"])
def test_crs_lines(header: str, tmp_path: Path) -> None:
    first = given(tmp_path, UTM).points[0].place
    again = given(tmp_path, UTM.replace("WGS84 UTM 32N", header)).points[0].place
    assert first is not None and again is not None
    assert (again.lat, again.lon) == pytest.approx((first.lat, first.lon), abs=1e-9)


def test_points_without_names_are_told_apart_by_their_coordinates(tmp_path: Path) -> None:
    text = UTM.replace(" north extra", "").replace(" north", "").replace(" east", "")
    assert [len(one.marks) for one in given(tmp_path, text).points] == [2, 1]


def test_geo_txt_and_tables(tmp_path: Path) -> None:
    found = given(tmp_path, GEO, POINTS.replace("P,", "Q,"), ENDS, BARS)
    a, b = found.positions
    assert (a.image, a.place.lat, a.place.lon, a.place.height) == ("a.jpg", 47.8, 9.0, 500.0)
    assert (a.place.sigma_h, a.place.sigma_v) == (0.02, 0.04)
    assert np.isnan(b.place.height) and b.place.sigma_h == pytest.approx(0.05 / CE90_PER_SIGMA)
    q, *ends = found.points
    assert q.marks[0].u == 1.5 and q.place is not None and q.place.sigma_h == 0.01 and len(q.marks) == 2
    assert all(one.place is None for one in ends)
    (bar,) = found.bars
    assert (bar.name, bar.length_m, bar.sigma_m) == ("A to B", 12.5, 0.002)
    (position,) = given(tmp_path, POSITIONS).positions
    assert position.place.sigma_h == pytest.approx(0.03 / CE90_PER_SIGMA)


def test_x_and_y_of_a_table_have_the_crs_that_is_stated(tmp_path: Path) -> None:
    text = "image,x,y,z\na.jpg,500000,5300000,432.5\n"
    stated = Stated("EPSG:32632", "ellipsoid", 0.05, 0.08)
    place = given(tmp_path, text, stated=stated).positions[0].place
    first = given(tmp_path, UTM).points[0].place
    assert first is not None and (place.lat, place.lon) == pytest.approx((first.lat, first.lon))
    with pytest.raises(InputError, match=r"0\.txt, line 2: x and y need their CRS: write crs"):
        given(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty; an ODM list begins with its CRS"),
        ("EPSG:99999\n1 2 3 4 5 a.jpg\n", "line 1: 'EPSG:99999' is no CRS that PROJ knows; an ODM list begins"),
        ("name;x;y\n1;2;3\n", "line 1: 'name;x;y' is no CRS"),
        (UTM.replace("99.5 199.5", "99.5 nan"), "line 2: py = nan must be a finite number"),
        (UTM.replace("99.5 199.5", "99.5 1o"), "line 2: py = '1o' is not a number"),
        (UTM.replace("NaN 30 40 a.jpg east", "NaN 30"), "line 4: has 4 words"),
        (UTM.replace("20 b.jpg", "20 a.jpg"), "line 3: a.jpg is listed for north before, in"),
        (UTM.replace("432.5 10", "432.9 10"), "line 3: north has other coordinates than in"),
        (UTM.replace("WGS84 UTM 32N", "EPSG:4326"), "line 2: 500000 5.3e+06 is not on Earth in EPSG:4326"),
        (POSITIONS + "a.jpg,47,9,1,1,1\n", "line 3: a.jpg is listed before, in"),
        (POSITIONS.replace("0.03", "-1"), "line 2: ce90 = -1 must be metres above zero"),
        (POSITIONS.replace("500,", ""), "line 2: has 5 cells, the first line 6"),
        (POSITIONS.replace("lat,lon", "latitude,longitude"), "has no coordinates; give lat,lon,height"),
        (POINTS.replace("px,", "u,"), "the column px is missing; a table of this kind has point,image,px,py"),
        (BARS, "line 2: there is no point A; give its pixels"),
        (BARS.replace(",0.002", ",0"), "line 2: a scale bar needs two points"),
    ],
)
def test_what_is_wrong_is_one_line(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        given(tmp_path, text)
    assert words in str(error.value) and "0.txt" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        (Stated(None, "ellipsoid", None, 0.1), "accuracy of the control is not stated: write ce90 = M in [control]"),
        (Stated(None, "ellipsoid"), "--control-ce90 M --control-le90 M, or columns sigma_h and sigma_v"),
        (Stated(None, None, 0.1, 0.1), "the vertical datum of the control is not stated"),
        (Stated(None, "EPSG:1", 0.1, 0.1), "line 2: vertical datum 'EPSG:1' is not known"),
    ],
)
def test_nothing_is_assumed(stated: Stated, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        given(tmp_path, UTM, stated=stated)
    assert words in str(error.value) and "0.txt, line 2" in str(error.value)


def test_photos_by_name_or_path(tmp_path: Path) -> None:
    control = given(tmp_path, UTM)
    found, notes = resolved(control, {"air/a.jpg": (400, 300), "air/b.jpg": None})
    assert [mark.image for mark in found.points[0].marks] == ["air/a.jpg", "air/b.jpg"] and not notes
    found, notes = resolved(control, {"air/a.jpg": (400, 300)})
    assert [len(point.marks) for point in found.points] == [1, 1]
    assert notes == ["control: b.jpg: not among the photos of the site; left out"]
    for photos, words in (
        ({"air/a.jpg": None, "ground/a.jpg": None}, "line 2: a.jpg may be air/a.jpg or ground/a.jpg; write the one"),
        ({"air/a.jpg": (90, 300)}, "pixel 100 200 lies outside of air/a.jpg, which has 90 by 300 pixels"),
        ({"air/c.jpg": None}, "none of the photos named there is in the site, such as a.jpg"),
    ):
        with pytest.raises(InputError) as error:
            resolved(control, photos)  # type: ignore[arg-type]
        assert words in str(error.value)


def test_the_table_of_a_site(tmp_path: Path) -> None:
    site = make_site(tmp_path)
    (site / "gcp.txt").write_text(UTM, encoding="utf-8")
    table = '\n[control]\nfiles = ["gcp.txt"]\nvertical_datum = "ellipsoid"\nce90 = 0.05\nle90 = 0.1\nuse = true\n'
    (site / "site.toml").write_text(SITE + table, encoding="utf-8")
    control = load_site(site / "site.toml").control
    assert control is not None and control.given is not None and control.use and control.given.use
    assert len(control.given.points) == 2
    again = control_from_plain(plain(plain_control(control)))
    assert again is not None and str(again.given) == str(control.given) and again.use
    more = control_with_arguments(None, [site / "gcp.txt"], 0.05, 0.1, "ellipsoid", use=False)
    assert more is not None and more.given is not None and not more.given.use
    assert control_with_arguments(None, (), None, None, None, use=False) is None
    with pytest.raises(InputError, match="there is no control; give --control FILE"):
        control_with_arguments(None, (), None, None, None, use=True)
    for change, words in (
        (("gcp.txt", "gpc.txt"), "control.files: there is no file"),
        (("use = true", "use = 1"), "control.use = 1 must be true or false"),
        (("ce90 = 0.05", "ce90 = 0"), "control.ce90 = 0 must be metres above zero"),
        (("use =", "uses ="), "unknown key uses in [control]; did you mean use?"),
        (("files =", "file ="), "unknown key file in [control]; did you mean files"),
        (("ce90 = 0.05", 'crs = "x"'), "control.crs: 'x' is no CRS that PROJ knows"),
    ):
        (site / "site.toml").write_text(SITE + table.replace(*change), encoding="utf-8")
        with pytest.raises(InputError) as error:
            load_site(site / "site.toml")
        assert words in " ".join([str(error.value), *error.value.details])
