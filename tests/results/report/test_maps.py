# SPDX-License-Identifier: Apache-2.0
"""Maps of the report: scale, enlargement, overlap, match graph."""

from __future__ import annotations

import re

import numpy as np
import pytest

from skymoor.results.report.maps import (
    OVERLAP,
    ellipse,
    enlargement,
    furniture,
    match_graph,
    overlap_map,
    scale_length,
)


@pytest.mark.parametrize("width_m", [0.7, 9.9, 37.0, 150.0, 360.0, 4200.0, 99999.0])
def test_a_scale_bar_is_round_and_fits(width_m: float) -> None:
    length = scale_length(width_m)
    assert 0.1 * width_m < length <= 0.28 * width_m
    assert f"{length:.0e}"[0] in "125"


def test_the_bar_is_as_long_as_it_says() -> None:
    drawn = furniture((-50.0, -100.0, 200.0, 120.0))
    found = re.search(r'd="M([\d.-]+) [\d.-]+V[\d.-]+H([\d.-]+)V', drawn)
    assert found is not None and ">50 m<" in drawn
    assert float(found[2]) - float(found[1]) == pytest.approx(50.0, abs=0.02)
    assert ">2 km<" in furniture((0.0, 0.0, 9000.0, 9000.0))


@pytest.mark.parametrize(("metres", "wanted"), [(4.0, 1), (1.0, 2), (0.1, 20), (1e-12, 1000)])
def test_small_ellipses_are_enlarged_by_a_round_factor(metres: float, wanted: int) -> None:
    assert enlargement([metres] * 3, (0.0, 0.0, 100.0, 80.0)) == wanted
    assert enlargement([], (0.0, 0.0, 1.0, 1.0)) == 1


def test_an_ellipse_points_along_its_azimuth() -> None:
    """North is up, so the longer axis of azimuth 0 is turned a quarter back from the x axis of the drawing."""
    assert 'rx="6.000" ry="2.000" transform="rotate(-90.0 1.0 -2.0)"' in ellipse(1.0, -2.0, [3.0, 1.0, 0.0], 2, "ce90")
    assert "rotate(0.0 " in ellipse(0.0, 0.0, [3.0, 1.0, 90.0], 1, "ce90")


def test_overlap_has_its_legend_and_its_place() -> None:
    counts = np.array([[0, 1, 2], [3, 5, 12]])
    found = {"west": -30.0, "north": 40.0, "cell_m": 10.0, "counts": counts.tolist()}
    drawing = overlap_map(found, ortho=True)
    assert [text for _, text in drawing.legend] == ["1", "2", "3", "4 to 5", "6 to 8", "9 or more"]
    assert [colour for colour, _ in drawing.legend] == [colour for _, colour in OVERLAP]
    assert 'x="-30.00" y="-40.00" width="30.00" height="20.00"' in drawing.svg and 'href="#ortho"' in drawing.svg
    assert "3 in the median and 12 at most" in drawing.words


def test_lines_are_as_wide_as_photos_share_points() -> None:
    places = [(0.0, 0.0), (10.0, 0.0), (20.0, 5.0), None]
    drawing = match_graph([[0, 1, 200], [1, 2, 20], [2, 3, 500]], places, ortho=False)
    widths = [float(one) for one in re.findall(r"stroke-width:([\d.]+)px", drawing.svg)]
    assert len(widths) == 2 and widths == sorted(widths)  # a photo without a place has no line; the widest is on top
    assert widths[1] == pytest.approx(5.0) and widths[0] == pytest.approx(0.6 + 4.4 * 0.1, abs=0.06)
    assert "20 tie points where they are finest, 200 where they are widest" in drawing.words
    assert "M0.00 -0.00L10.00 -0.00" in drawing.svg and "M10.00 -0.00L20.00 -5.00" in drawing.svg
