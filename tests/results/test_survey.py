# SPDX-License-Identifier: Apache-2.0
"""What a run records of its date, its coordinate systems and its search."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from skymoor.geo import EnuFrame, Grid
from skymoor.geometry import Similarity
from skymoor.pipeline.job import ComponentResult, MapHypothesis
from skymoor.pipeline.reference_files import ReferenceFiles
from skymoor.pipeline.site import Site
from skymoor.results.survey import ELLIPSOIDAL, hypotheses_of, reference_heights, run_figures
from skymoor.store import StageRecord
from skymoor.types import Reference, Registration
from support.blocks import block

MASK = np.arange(40 * 30).reshape(40, 30) % 4 > 0
REFERENCE = Reference(
    EnuFrame(47.0, 8.0, 400.0),
    Grid(-20.0, 20.0, 2.0, (40, 30)),
    np.zeros((40, 30, 3), np.uint8),
    MASK,
    np.zeros((40, 30), np.float32),
    np.eye(3),
    0.5,
    crs="EPSG:2056",
)


def site(datum: str | None, dsm: Path | float | None = 3.0) -> Site:
    return Site("s", Path(), ReferenceFiles(Path("ortho.tif"), dsm, datum, np.eye(3)), (Path("air"),), ())


def test_a_run_is_dated_and_named_by_its_systems() -> None:
    records = [StageRecord("a", "0", 2.5, 1.0, False), StageRecord("b", "0", 4.0, 1.0, True)]
    found = run_figures(site("EPSG:3855"), REFERENCE, records)
    when = datetime.fromisoformat(found["date"])
    assert when.utcoffset() == timedelta(0) and abs(datetime.now(UTC) - when) < timedelta(minutes=5)
    assert found["seconds"] == 6.5
    assert found["coordinate_systems"] == {
        "crs": {"name": "CH1903+ / LV95", "epsg": 2056},
        "heights": ELLIPSOIDAL,
        "reference_heights": {"name": "EGM2008 height", "epsg": 3855},
    }
    assert found["search"]["bounds_m"] == (-20.0, -60.0, 40.0, 20.0) and not found["search"]["limited"]
    assert found["search"]["area_m2"] == pytest.approx(MASK.sum() * 4.0)


@pytest.mark.parametrize(
    ("datum", "wanted"),
    [
        ("ellipsoid", ELLIPSOIDAL),
        ("EPSG:5773", {"name": "EGM96 height", "epsg": 5773}),
        (None, None),
        ("nonsense", None),
    ],
)
def test_the_vertical_system_has_a_name_or_is_not_told(datum: str | None, wanted: object) -> None:
    assert reference_heights(site(datum)) == wanted


def test_the_vertical_system_is_that_of_the_file(tmp_path: Path) -> None:
    shape = {"driver": "GTiff", "width": 8, "height": 8, "count": 1, "dtype": "float32"}
    place = Affine(1.0, 0.0, 500000.0, 0.0, -1.0, 5300000.0)
    with rasterio.open(tmp_path / "dsm.tif", "w", **shape, crs="EPSG:32632+5773", transform=place) as file:
        file.write(np.zeros((1, 8, 8), np.float32))
    assert reference_heights(site(None, tmp_path / "dsm.tif")) == {"name": "EGM96 height", "epsg": 5773}
    assert reference_heights(site(None, tmp_path / "gone.tif")) is None


def test_without_heights_there_is_no_vertical_system() -> None:
    flat = replace(REFERENCE, height=np.full((40, 30), np.nan, np.float32))
    assert run_figures(site("EPSG:3855"), flat, [])["coordinate_systems"]["reference_heights"] is None


def test_hypotheses_tell_how_far_they_are_from_the_first() -> None:
    places = [(90.0, 1.0, 2.0), (60.0, 31.0, -38.0), (20.0, 1.0, 2.0), (10.0, 0.0, 0.0)]
    hypotheses = [MapHypothesis(score, east, north, 0.0, 1.0) for score, east, north in places]
    component = block("nadir", relief_m=1.0, n=30)
    item = ComponentResult("a", component, Similarity.identity(), Registration(False, "", None), hypotheses=hypotheses)
    assert [one["distance_m"] for one in hypotheses_of(item, REFERENCE)] == pytest.approx([0.0, 50.0, 0.0])
