# SPDX-License-Identifier: Apache-2.0
"""Buildings: holes where openings are, glass behind the walls, roofs at their heights, equal and unequal looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.simulate.building.assemble import BROKEN_SHARE, daily_parts, fixed_parts
from skymoor.simulate.building.covers import roof_texture
from skymoor.simulate.building.facades import FOOT_M, cells_without
from skymoor.simulate.building.materials import COLOURS, joint, octaves, wall_texture
from skymoor.simulate.building.openings import is_hall, openings_of, rects, styles, wall_lengths
from skymoor.simulate.building.painting import painted_wall
from skymoor.simulate.building.roofs import parapet_m, profile, span_of
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.mesh import Label, Part, rectangle, stream
from skymoor.simulate.plan import Building

L_SHAPE = ((-10.0, -6.0), (10.0, -6.0), (10.0, 6.0), (0.0, 6.0), (0.0, 11.0), (-10.0, 11.0))
HOUSE = Building(
    name="B1",
    east=0.0,
    north=0.0,
    up=0.0,
    heading_deg=0.0,
    outline=tuple(rectangle(18.0, 10.0)),
    storeys=3,
    storey_m=3.4,
    roof="flat",
    wall="brick",
    cover="membrane",
    looks=11,
)
HALL = replace(HOUSE, wall="metal", storeys=1, storey_m=7.0, roof="sawtooth", cover="metal")
MANY = [
    HOUSE,
    HALL,
    replace(HOUSE, outline=L_SHAPE, wall="concrete", cover="gravel", looks=12),
    replace(HOUSE, roof="gable", wall="plaster", cover="tiles", looks=13),
    replace(HOUSE, roof="hip", wall="panels", cover="tiles", looks=14),
    replace(HALL, roof="shed", looks=15),
    replace(HOUSE, repeated=True, looks=16),
    replace(HOUSE, water_up=1.0, looks=17),
]


def _bytes(pages: Pages) -> int:
    return 4 * sum(level.size for levels in pages._levels for level in levels)


def _area(part: Part, label: Label) -> float:
    edges = part.corners[part.label == label, 1:] - part.corners[part.label == label, :1]
    return float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2)


def _same(a: Part, b: Part) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("corners", "uv", "page", "label", "tint")
    )


holes = st.lists(
    st.tuples(st.floats(0, 9), st.floats(0, 5), st.floats(0.1, 3), st.floats(0.1, 3)), min_size=0, max_size=5
)


@given(holes)
@settings(max_examples=60, deadline=None)
def test_cells_fill_what_holes_leave(sizes: list[tuple[float, float, float, float]]) -> None:
    rect = np.array([(x, z, x + w, z + h) for x, z, w, h in sizes]).reshape(-1, 4)
    cells = cells_without(rect, (0.0, 0.0, 10.0, 6.0))
    points = np.random.default_rng(3).uniform((0, 0), (10, 6), (400, 2))

    def times(boxes: NDArray[np.float64]) -> NDArray[np.intp]:
        x, z = points[:, :1], points[:, 1:]
        within = (boxes[:, 0] < x) & (x < boxes[:, 2]) & (boxes[:, 1] < z) & (z < boxes[:, 3])
        return np.asarray(within.sum(axis=1))

    np.testing.assert_array_equal(times(cells), (times(rect) == 0).astype(int))


@pytest.mark.parametrize("building", MANY, ids=lambda b: f"{b.wall} {b.roof}")
def test_openings_lie_apart_in_their_walls(building: Building) -> None:
    count = 0
    for wall, length in enumerate(wall_lengths(building)):
        rect = rects(openings_of(building, wall))
        count += len(rect)
        assert (rect[:, 0] >= 0.25).all() and (rect[:, 2] <= length - 0.25).all()
        assert (rect[:, 1] >= 0.0).all() and (rect[:, 3] <= building.walls_m - 0.1).all()
        sizes = rect[:, 2:] - rect[:, :2]
        assert (sizes > 0.3).all()
        for k, box in enumerate(rect):
            others = np.delete(rect, k, axis=0)
            clash = (others[:, :2] < box[2:] + 0.1) & (box[:2] - 0.1 < others[:, 2:])
            assert not clash.all(axis=1).any()
    assert 8 <= count <= 150


@pytest.mark.parametrize("building", MANY, ids=lambda b: f"{b.wall} {b.roof}")
def test_a_fine_building_keeps_its_budget(building: Building) -> None:
    pages = Pages()
    part = fixed_parts(building, pages)
    assert 1500 < len(part) <= 30_000
    assert 1e6 < _bytes(pages) <= 15e6
    assert np.isfinite(part.corners).all() and np.isfinite(part.uv).all()
    assert part.page.max() < len(pages._levels)
    edges = part.corners[:, 1:] - part.corners[:, :1]
    assert np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).min() > 1e-7
    assert {Label.WALL, Label.ROOF, Label.GLASS, Label.OBJECT} <= set(part.label)


@pytest.mark.parametrize("building", MANY, ids=lambda b: f"{b.wall} {b.roof}")
def test_a_coarse_building_has_the_same_shape_and_little_else(building: Building) -> None:
    pages, fine_pages = Pages(), Pages()
    far = fixed_parts(replace(building, fine=False), pages)
    fine = fixed_parts(building, fine_pages)
    assert 8 <= len(far) < 150
    assert _bytes(pages) < 0.1 * _bytes(fine_pages)
    solid = far.corners[np.isin(far.label, (Label.WALL, Label.ROOF))]
    body = fine.corners[np.isin(fine.label, (Label.WALL, Label.ROOF))]
    for axis in (0, 1):
        assert abs(np.ptp(solid[..., axis]) - np.ptp(body[..., axis])) < 3.0
    assert abs(solid[..., 2].max() - body[..., 2].max()) < 3.0
    assert len(daily_parts(replace(building, fine=False), pages, "a")) == 0


def test_walls_have_holes_where_openings_are() -> None:
    """Area of the faces in a wall's plane: the wall less its openings, to a few per mille."""
    building = replace(HALL, roof="flat", cover="membrane")
    part = fixed_parts(building, Pages())
    top = building.walls_m + parapet_m(building)
    in_plane = (part.label == Label.WALL) & (np.abs(part.corners[..., 1] + 5.0) < 1e-3).all(axis=1)
    edges = part.corners[in_plane, 1:] - part.corners[in_plane, :1]
    area = float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2)
    rect = rects(openings_of(building, 0))
    cut = float(np.prod(rect[:, 2:] - rect[:, :2], axis=1).sum())
    assert cut > 15.0
    assert area == pytest.approx(18.0 * (top - FOOT_M) - cut, rel=3e-3)


def test_glass_lies_behind_the_wall_and_before_the_middle() -> None:
    part = fixed_parts(HOUSE, Pages())
    panes = part.corners[part.label == Label.GLASS]
    normal = np.cross(panes[:, 1] - panes[:, 0], panes[:, 2] - panes[:, 0])
    front = (normal[:, 1] < 0) & (np.abs(normal[:, 0]) < 1e-6) & (np.abs(normal[:, 2]) < 1e-6)
    depth = panes[front][:, :, 1] + 5.0
    assert front.sum() > 20
    assert depth.min() > 0.095 and depth.max() < 0.205
    assert depth.max() == pytest.approx(max(styles(HOUSE)[0].recess_m, 0.18), abs=0.02)


def test_a_flood_breaks_its_share_of_panes() -> None:
    shares = []
    for looks in range(40, 44):
        dry = replace(HOUSE, looks=looks)
        whole, broken = (fixed_parts(b, Pages()) for b in (dry, replace(dry, water_up=1.0)))
        shares.append(1 - _area(broken, Label.GLASS) / _area(whole, Label.GLASS))
    assert 0.6 * BROKEN_SHARE < np.mean(shares) < 1.5 * BROKEN_SHARE


def test_a_flood_marks_the_wall_up_to_a_line_and_not_above() -> None:
    texel, top = 0.04, 10.6
    wet = replace(HOUSE, up=3.0, water_up=3.9)
    dry, marked = (painted_wall(b, 0, openings_of(b, 0), top, texel)[0] for b in (HOUSE, wet))
    change = np.abs(marked / dry - 1).mean(axis=(1, 2))
    up = top - (np.arange(len(dry)) + 0.5) * texel
    assert change[up > 0.9 + 1.3].max() < 1e-3
    assert change[(up > 0.9) & (up < 0.9 + 0.4)].min() > 0.05


def test_placing_moves_and_turns_and_changes_nothing_else() -> None:
    here = fixed_parts(HOUSE, Pages())
    there = fixed_parts(replace(HOUSE, east=40.0, north=-7.0, up=2.5, heading_deg=90.0), Pages())
    back = there.corners - np.array([40.0, -7.0, 2.5])
    turned = np.stack([back[..., 1], -back[..., 0], back[..., 2]], axis=-1)
    np.testing.assert_allclose(turned, here.corners, atol=2e-5)
    np.testing.assert_array_equal(there.uv, here.uv)


def test_buildings_of_equal_looks_are_twins_and_others_are_not() -> None:
    pages = [Pages() for _ in range(3)]
    first = fixed_parts(HOUSE, pages[0])
    twin = fixed_parts(replace(HOUSE, name="B2"), pages[1])
    other = fixed_parts(replace(HOUSE, looks=99), pages[2])
    assert _same(first, twin)
    for a, b in zip(pages[0]._levels, pages[1]._levels, strict=True):
        np.testing.assert_array_equal(a[0], b[0])
    assert len(first) != len(other)


def test_days_differ_and_what_is_fixed_does_not() -> None:
    building = replace(HOUSE, roof="gable", cover="tiles")
    pages = Pages()
    before = fixed_parts(building, Pages())
    monday, tuesday, again = (daily_parts(building, pages, day) for day in ("monday", "tuesday", "monday"))
    assert _same(before, fixed_parts(building, Pages()))
    np.testing.assert_array_equal(monday.corners, again.corners)
    assert not np.array_equal(monday.corners, tuesday.corners)
    assert len(monday) > 100 and len(tuesday) > 100


def test_things_before_the_walls_stand_on_the_ground() -> None:
    building = replace(HOUSE, east=100.0, north=50.0, up=20.0, heading_deg=37.0)
    flat = daily_parts(building, Pages(), "a")
    raised = daily_parts(building, Pages(), "a", ground=lambda e, n: 20.7 + 0.0 * e)
    lift = (raised.corners - flat.corners)[..., 2]
    standing = lift.max(axis=1) > 0.35
    np.testing.assert_allclose(lift[standing], 0.7, atol=1e-4)
    np.testing.assert_allclose(lift[~standing], 0.0, atol=1e-4)
    assert standing.any() and not standing.all()
    assert flat.corners[standing][..., 2].min() == pytest.approx(20.0, abs=0.05)

    def slope(east: NDArray[np.float64], north: NDArray[np.float64]) -> NDArray[np.float64]:
        return 20.0 + 0.1 * (east - 100.0) + 0.05 * (north - 50.0)

    tilted = daily_parts(building, Pages(), "a", ground=slope)
    middle = flat.corners.mean(axis=1)[standing]
    expected = slope(middle[:, 0], middle[:, 1]) - 20.0
    assert np.abs((tilted.corners - flat.corners)[standing][..., 2].mean(axis=1) - expected).max() < 0.2


@pytest.mark.parametrize("building", MANY, ids=lambda b: f"{b.wall} {b.roof}")
def test_the_roof_is_where_its_kind_puts_it(building: Building) -> None:
    part = fixed_parts(building, Pages())
    roof = part.corners[part.label == Label.ROOF]
    highest = max(profile(building, wall)[:, 1].max() for wall in range(len(building.outline)))
    if building.roof == "flat":
        assert 0.3 <= parapet_m(building) <= 0.9
        assert roof[..., 2].min() == pytest.approx(building.walls_m, abs=1e-3)
        assert highest == pytest.approx(building.walls_m + parapet_m(building))
        return
    span = span_of(building)
    assert 0.3 <= span.overhang_m <= 0.6
    ridge = building.walls_m + span.rise_m
    assert ridge - 0.05 < roof[..., 2].max() < ridge + 0.5
    if building.roof != "hip":
        assert highest == pytest.approx(ridge)
    if building.roof in ("gable", "hip", "shed"):
        over = np.ptp(roof[..., 1]) - 10.0 - 2 * span.overhang_m
        assert -0.01 < over < (0.2 if building.roof == "hip" else 0.01)  # the caps of hips reach over the corners


def test_a_ridge_runs_along_the_longer_side() -> None:
    turned = replace(HOUSE, roof="gable", cover="tiles", outline=tuple(rectangle(10.0, 18.0)))
    part = fixed_parts(turned, Pages())
    high = part.corners[(part.label == Label.ROOF) & (part.corners[..., 2].min(axis=1) > turned.walls_m + 1.0)]
    assert np.abs(high[..., 0]).max() < 4.0 < 9.0 < np.abs(high[..., 1]).max()
    assert [len(profile(turned, wall)) for wall in range(4)] == [3, 2, 3, 2]


def test_a_pitched_roof_wants_a_rectangle() -> None:
    with pytest.raises(InputError, match="B7: a gable roof needs four corners"):
        fixed_parts(replace(HOUSE, name="B7", roof="gable", outline=L_SHAPE), Pages())


def test_bays_repeat_only_where_they_shall() -> None:
    even, uneven = (openings_of(replace(HOUSE, repeated=repeated), 0) for repeated in (True, False))
    upper = np.array([o.x0 for o in even if o.z0 > 7.0])
    np.testing.assert_allclose(np.diff(upper), np.diff(upper)[0], atol=1e-9)
    steps = np.diff(np.sort([o.x0 for o in uneven if o.z0 > 7.0]))
    assert np.std(steps) > 0.03


def test_a_repeated_facade_paints_one_bay() -> None:
    building = replace(HOUSE, repeated=True)
    openings = openings_of(building, 0)
    page, texel = painted_wall(building, 0, openings, 10.6, 0.02)
    bay = float(np.diff([o.x0 for o in openings if o.z0 > 7.0])[0])
    assert page.shape[1] * texel == pytest.approx(bay, rel=1e-6)


@pytest.mark.parametrize("material", COLOURS)
def test_walls_are_muted_uneven_and_of_their_colour(material: str) -> None:
    colour = np.array(COLOURS[material][0])
    page = wall_texture(material, stream(5, material), (300, 500), 0.02, colour)
    assert 0.7 < page.mean() / colour.mean() < 1.3
    ratio = page.mean(axis=(0, 1)) / page.mean()
    np.testing.assert_allclose(ratio, colour / colour.mean(), atol=0.2)
    assert 0.05 < page.std(axis=(0, 1)).mean() / page.mean() < 0.5
    other = wall_texture(material, stream(6, material), (300, 500), 0.02, colour)
    assert abs(np.corrcoef(page.ravel(), other.ravel())[0, 1]) < 0.9


def test_no_place_of_a_wall_looks_like_another() -> None:
    """Pieces of a wall half a metre wide hardly correlate with any other piece of it in the same course."""
    page = painted_wall(HOUSE, 0, openings_of(HOUSE, 0), 10.6, 0.02)[0].mean(axis=2)
    row = page[60:110]
    pieces = np.stack([row[:, x : x + 25].ravel() for x in range(0, row.shape[1] - 25, 12)])
    alike = np.corrcoef(pieces)
    apart = np.abs(np.subtract.outer(np.arange(len(pieces)), np.arange(len(pieces)))) > 2
    assert alike[apart].max() < 0.85


@pytest.mark.parametrize(("period", "width"), [(0.3, 0.05), (1.2, 0.012), (0.075, 0.012)])
def test_joints_cover_their_share(period: float, width: float) -> None:
    texel = 0.02
    cover = joint((np.arange(30_000) + 0.5) * texel * 1.0007, period, width, texel)
    assert cover.mean() == pytest.approx(width / period, rel=0.03)


def test_octaves_have_the_deviation_of_their_number() -> None:
    field = octaves(np.random.default_rng(1), (1200, 1200), 0.05, 0.05, largest_m=4.0, smallest_m=0.4)
    count = 5  # 4, 2, 1, 0.5 and 0.25 m
    assert 0.5 * 0.05 * np.sqrt(count) < field.std() < 0.05 * np.sqrt(count)
    assert abs(field.mean()) < 0.02


def test_a_plain_roof_gives_little_to_hold_on_to() -> None:
    plain, usual = (
        roof_texture("membrane", np.random.default_rng(2), (300, 300), 0.03, (0.4, 0.4, 0.4), plain=plain)
        for plain in (True, False)
    )
    assert 0.002 < plain.std() < 0.45 * usual.std()


def test_halls_have_gates_and_houses_have_windows() -> None:
    kinds = {b.wall: [o.kind for wall in range(4) for o in openings_of(b, wall)] for b in (HOUSE, HALL)}
    assert is_hall(HALL) and not is_hall(HOUSE)
    assert {"roller", "dock"} & set(kinds["metal"]) and not {"roller", "dock"} & set(kinds["brick"])
    assert kinds["brick"].count("window") > 20
    assert sum(kind in ("glazed", "steel") for kind in kinds["brick"]) >= 1
