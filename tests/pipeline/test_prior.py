# SPDX-License-Identifier: Apache-2.0
"""What somebody knows of area, heading and height bounds the search, and nothing else does."""

from __future__ import annotations

import numpy as np
import pytest

from skymoor.errors import InputError
from skymoor.geometry import Intrinsics, Similarity
from skymoor.match.propose import ALL_AZIMUTHS, is_turned_within
from skymoor.pipeline.prior import Heading, SearchPrior, prior_from_table
from skymoor.types import Camera


def camera(name: str, heading_deg: float, tilt_deg: float) -> Camera:
    """At a heading in its frame; a tilt of 0 looks straight down, with the upper edge to the heading."""
    h, t = np.radians([heading_deg, tilt_deg])
    ahead, up = np.array([np.sin(h), np.cos(h), 0.0]), np.array([0.0, 0.0, 1.0])
    forward = np.sin(t) * ahead - np.cos(t) * up
    down = -np.cos(t) * ahead - np.sin(t) * up
    rotation = np.array([np.cross(down, forward), down, forward])
    assert np.linalg.det(rotation) == pytest.approx(1)
    return Camera(name, Intrinsics(100, 80, 90.0, 90.0, 50.0, 40.0), Similarity(1.0, rotation, np.zeros(3)))


@pytest.mark.parametrize("tilt_deg", [0.0, 10.0, 45.0, 85.0, 100.0])
def test_the_azimuth_of_the_frame_follows_from_one_photo(tilt_deg: float) -> None:
    cameras = [camera("a/2.jpg", 10.0, tilt_deg), camera("a/1.jpg", 70.0, tilt_deg)]
    middle, half = Heading(100.0).azimuths(cameras)  # the first by name stands at 70 in its frame
    assert np.degrees(middle) % 360 == pytest.approx(30.0)
    assert np.degrees(half) == pytest.approx(20.0)
    other, _ = Heading.parsed("2.jpg=100").azimuths(cameras)
    assert np.degrees(other) % 360 == pytest.approx(90.0)
    assert Heading.parsed("3.jpg=100").azimuths(cameras) == ALL_AZIMUTHS


def test_ranges_go_round_the_compass() -> None:
    around_north = (np.radians(355.0), np.radians(20.0))
    turned = [is_turned_within(np.radians(degrees), around_north) for degrees in (334, 336, 0, -5, 14, 16, 180)]
    assert turned == [False, True, True, True, True, False, False]
    assert all(is_turned_within(x, ALL_AZIMUTHS) for x in np.linspace(-7, 7, 50))


def test_near_is_a_square_of_twice_the_radius() -> None:
    west, south, east, north = SearchPrior.of(near=(60.0, 10.0, 500.0)).area or ()
    assert (north - south) * 111_412 == pytest.approx(1000, rel=0.01)
    assert (east - west) * 55_800 == pytest.approx(1000, rel=0.01)
    assert (west + east) / 2 == pytest.approx(10.0) and (south + north) / 2 == pytest.approx(60.0, abs=1e-5)


def test_a_height_sets_the_options_and_nothing_sets_none() -> None:
    options = SearchPrior.of(height=100.0).options()
    assert options == {"match.min_height_m": 80.0, "match.max_height_m": 125.0}
    assert SearchPrior().options() == {}
    site = SearchPrior.of(height=50.0, heading="90")
    assert site.overruled(SearchPrior.of(height=80.0)) == SearchPrior.of(height=80.0, heading="90")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"area": [1, 2, 3]}, "prior.area = [1, 2, 3] must be a list of 4 numbers"),
        ({"area": [9.0, 47.0, 8.0, 48.0]}, "west below east"),
        ({"near": [1, 2, True]}, "prior.near"),
        ({"near": [95.0, 2.0, 100.0]}, "latitude, longitude and a radius"),
        ({"near": [1.0, 2.0, 100.0], "area": [8.0, 47.0, 9.0, 48.0]}, "give one of them"),
        ({"heading": "north"}, "degrees clockwise from north"),
        ({"height": "80"}, "must be a number of metres"),
        ({"height": -3}, "flying height"),
    ],
)
def test_what_makes_no_sense_is_told_by_its_name(table: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=r"site\.toml") as error:
        prior_from_table(table, "site.toml")
    assert words in str(error.value)
