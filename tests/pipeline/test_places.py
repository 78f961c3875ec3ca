# SPDX-License-Identifier: Apache-2.0
"""Places found in a reduced reference are read again in all detail."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skymoor.match import ImageHypothesis, SearchOptions
from skymoor.pipeline.search import places_of, search_again
from skymoor.reference.read import read_reference
from skymoor.types import Raster, Render, View
from support.textured import PIXEL_M, SHAPE, cut, px_of, textured, write_map

TRUE = (1000.0, 420.0)  # pixel of the orthophoto


def render_of(image: Raster) -> Render:
    """A flat one with pixels of a hundredth of the flying height."""
    view = View(np.diag([1.0, -1.0, -1.0]), 0.0, 0.0, 0.01, SHAPE)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    xyz = np.stack([u * 0.01, -v * 0.01, 0 * u], axis=-1).astype(np.float32)
    return Render(view, image.rgb, xyz, np.ones(SHAPE, np.float32))


def test_a_place_is_refined_in_the_pixels_of_the_orthophoto(tmp_path: Path) -> None:
    wide = textured((900, 1324), 1)
    ortho = write_map(tmp_path / "ortho.tif", wide)
    whole = read_reference(ortho, None, None, np.eye(3), max_pixels=130_000)
    ratio = PIXEL_M / whole.grid.pixel_m
    assert 0.25 < ratio < 0.4
    assert any("read again" in note for note in whole.notes)
    # Off by what a search at this pixel leaves: a pixel, a degree, a percent.
    start = px_of(whole, ortho, *TRUE) + [0.8, -0.6]
    found = ImageHypothesis(0.505 * ratio, np.radians(41.0), tuple(start.tolist()), 33.0, by_features=True)
    render, files = render_of(cut(wide, 0.5, 40.0, TRUE)), (ortho, None, None)
    (place,) = places_of([found], render, whole, files, 0.2, SearchOptions())
    part, refined = place.reference, place.hypothesis
    assert part.frame == whole.frame and part.grid.pixel_m == pytest.approx(PIXEL_M, rel=1e-3)
    assert part.rgb[..., 0].size < 0.5 * wide.mask.size
    off_px = np.hypot(*(refined.centre_px - px_of(part, ortho, *TRUE)))
    assert off_px < 0.7 < np.hypot(0.8, 0.6) / ratio
    assert refined.scale == pytest.approx(0.5, rel=0.01)
    assert np.degrees(refined.azimuth_rad) == pytest.approx(40.0, abs=0.5)
    assert (refined.score, refined.by_features) == (33.0, True)  # of the search, which others are compared with
    # The part shows what the orthophoto does there.
    fine = read_reference(ortho, None, None, np.eye(3))
    u, v = (round(x) for x in fine.grid.px_from_enu(part.grid.enu_from_px([0.0, 0.0])))
    rows, columns = part.grid.shape
    same = fine.rgb[v : v + rows, u : u + columns].astype(int) - part.rgb
    assert np.abs(same).mean() < 6


def test_where_no_detail_was_lost_the_part_is_cut_out(tmp_path: Path) -> None:
    wide = textured((900, 1324), 1)
    ortho = write_map(tmp_path / "ortho.tif", wide)
    whole = read_reference(ortho, None, None, np.eye(3))
    assert not whole.detail_lost and not any("read again" in note for note in whole.notes)
    centre = px_of(whole, ortho, *TRUE)
    one = ImageHypothesis(0.25, 0.0, tuple(centre.tolist()), 9.0)
    render = render_of(cut(wide, 0.25, 0.0, TRUE))
    (place,) = places_of([one], render, whole, (tmp_path / "gone.tif", None, None), 0.2, SearchOptions())
    part, moved = place.reference, place.hypothesis
    assert part.rgb[..., 0].size < 0.2 * whole.rgb[..., 0].size and part.grid.pixel_m == whole.grid.pixel_m
    np.testing.assert_allclose(part.grid.enu_from_px(moved.centre_px), whole.grid.enu_from_px(centre), atol=1e-9)
    u, v = np.round(whole.grid.px_from_enu(part.grid.enu_from_px([0.0, 0.0]))).astype(int)
    rows, columns = part.grid.shape
    assert (part.rgb == whole.rgb[v : v + rows, u : u + columns]).all()
    assert (moved.scale, moved.azimuth_rad, moved.score) == (0.25, 0.0, 9.0)


def test_a_part_beyond_the_border_is_what_there_is(tmp_path: Path) -> None:
    whole = read_reference(write_map(tmp_path / "ortho.tif", textured((200, 300), 2)), None, None, np.eye(3))
    west, south, east, north = whole.grid.bounds
    assert whole.part([west - 50, south - 50, east + 50, north + 50]).rgb.shape == whole.rgb.shape
    assert whole.part([east + 10, north + 10, east + 20, north + 20]).rgb.shape == (1, 1, 3)
    corner = whole.part([west - 5, north - 20.3, west + 30.2, north + 5])
    assert corner.grid.shape == (41, 61) and corner.grid.bounds[0] == west and corner.grid.bounds[3] == north


def test_after_a_correction_the_same_places_are_refined(tmp_path: Path) -> None:
    """The level frame of the corrected model is turned, scaled and shifted against the first one."""
    wide = textured((900, 1324), 1)
    reference = read_reference(write_map(tmp_path / "ortho.tif", wide), None, None, np.eye(3))
    b = Raster(reference.rgb, reference.mask)
    first, corrected = (0.5, 40.0, (600.0, 420.0)), (0.46, 25.0, (620.0, 400.0))
    renders = [render_of(cut(b, *one)) for one in (first, corrected)]
    ground_px = np.random.default_rng(0).uniform(300, 800, (6, 2))  # under the cameras
    plans = []
    for scale, azimuth_deg, centre in (first, corrected):
        c, s = np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))
        image_px = (ground_px - centre) @ np.array([[c, -s], [s, c]]) / scale + np.array(SHAPE[::-1]) / 2
        plans.append(image_px * [0.01, -0.01])
    found = ImageHypothesis(first[0], np.radians(first[1]), first[2], 30.0, by_features=True)
    before, now = zip(renders, plans, strict=True)
    (again,) = search_again([found], before, now, reference, 0.2, SearchOptions())
    assert again.scale == pytest.approx(corrected[0], rel=0.01)
    assert np.degrees(again.azimuth_rad) == pytest.approx(corrected[1], abs=0.5)
    assert np.hypot(*np.subtract(again.centre_px, corrected[2])) < 1.0
    assert again.by_features and again.score > 15
