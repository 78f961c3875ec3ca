# SPDX-License-Identifier: Apache-2.0
"""The ground before cameras is rectified where it is seen, and agrees with the orthophoto where it belongs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.geometry import Intrinsics, Similarity
from skymoor.ground.plan_view.ground_colour import (
    NEAR,
    colour_map,
    ground_cells,
    ground_layers,
    ground_picture,
    moved_cells,
    smoothed_layers,
)
from skymoor.types import Camera, DepthMap

Image = NDArray[np.uint8]

SIDE, PIXEL = 200, 0.1  # level units: 20 x 20 camera heights


def lawns(side: int, seed: int = 0) -> Image:
    """Patches of several colours, with soft borders."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(40, 220, (side // 12 + 2, side // 12 + 2, 3)).astype(np.float32)
    return cv2.resize(coarse, (side, side), interpolation=cv2.INTER_LINEAR).astype(np.uint8)


def photo_of(ground: Image, *, occluder: bool = False, lit: float = 1.0) -> DepthMap:
    """A camera one unit above the middle of `ground`, looking towards +y and 25 degrees down."""
    lens = Intrinsics(320, 240, 240.0, 240.0, 160.0, 120.0)
    c, s = np.cos(np.radians(25)), np.sin(np.radians(25))
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, -s, -c], [0.0, c, -s]])
    camera = Camera("walk.jpg", lens, Similarity(1.0, rotation, -rotation @ [0.0, 0.0, 1.0]))
    u, v = np.meshgrid(np.arange(320) + 0.5, np.arange(240) + 0.5)
    rays = lens.rays(np.column_stack([u.ravel(), v.ravel()])) @ rotation
    x, y = ((rays[:, k] / np.maximum(-rays[:, 2], 0.02)).reshape(240, 320) for k in (0, 1))
    px = [(one / PIXEL + SIDE / 2 - 0.5).astype(np.float32) for one in (x, -y)]
    rgb = (cv2.remap(ground, *px, cv2.INTER_LINEAR) * lit).astype(np.uint8)
    unknown = np.full((240, 320), np.nan, np.float32)
    if occluder:
        unknown[:, 160:] = 1.2
    return DepthMap(camera, unknown, unknown, np.zeros((240, 320), np.uint8), rgb)


def test_the_ground_is_where_it_was() -> None:
    ground = lawns(SIDE)
    rgb, shown = ground_picture([photo_of(ground)], np.zeros((SIDE, SIDE), np.float32), PIXEL, np.zeros(2))
    assert 500 < shown.sum() < 4000
    rows, _ = np.nonzero(shown)
    y = (SIDE / 2 - rows - 0.5) * PIXEL
    assert y.min() > 0.5 and NEAR - 0.5 < y.max() < NEAR + 0.01  # before the camera, and no further without free space
    assert np.abs(rgb[shown].astype(int) - ground[shown]).mean() < 3
    everywhere = np.ones((SIDE, SIDE), np.float32)
    _, wider = ground_picture([photo_of(ground)], everywhere, PIXEL, np.zeros(2))
    assert wider.sum() > 1.5 * shown.sum()


def test_what_stands_before_the_ground_hides_it() -> None:
    _, shown = ground_picture([photo_of(lawns(SIDE), occluder=True)], np.zeros((SIDE, SIDE)), PIXEL, np.zeros(2))
    left, right = shown[:, : SIDE // 2].sum(), shown[:, SIDE // 2 :].sum()
    assert right < 0.3 * left


@pytest.mark.parametrize("azimuth_deg", [0.0, 30.0, 90.0, 200.0])
def test_it_agrees_best_where_it_belongs_in_any_light(azimuth_deg: float) -> None:
    ground = lawns(SIDE)
    rgb, shown = ground_picture([photo_of(ground, lit=0.55)], np.ones((SIDE, SIDE)), PIXEL, np.zeros(2))
    # The orthophoto: the ground turned counter-clockwise and twice as coarse, within other lawns.
    ortho, zoom, corner = lawns(400, seed=5), 0.5, np.array([150, 90])
    turn = cv2.getRotationMatrix2D((SIDE / 2 - 0.5, SIDE / 2 - 0.5), azimuth_deg, zoom)
    size = int(np.ceil(SIDE * zoom * np.sqrt(2)))
    turn[:, 2] += size / 2 - SIDE / 2
    inside = cv2.warpAffine(np.full((SIDE, SIDE), 255, np.uint8), turn, (size, size)) > 128
    window = ortho[corner[1] : corner[1] + size, corner[0] : corner[0] + size]
    window[inside] = cv2.warpAffine(ground, turn, (size, size))[inside]
    target = colour_map(ortho, np.ones((400, 400), bool))
    cells = ground_cells(smoothed_layers(ground_layers(rgb, shown), zoom), zoom, np.radians(azimuth_deg), size)
    wide, near = np.arange(0, 250, 12), np.arange(-4, 5)
    places = np.stack(np.meshgrid(wide, wide), axis=-1).reshape(-1, 2)
    places = np.concatenate([places, corner + np.stack(np.meshgrid(near, near), axis=-1).reshape(-1, 2)])
    found = cells.agreement(target, places)
    assert np.abs(places[np.argmax(found)] - corner).max() <= 2
    assert found.max() > 0.85
    far = np.abs(places - corner).max(axis=1) > 20
    assert np.abs(found[far].mean()) < 0.15 and found[far].max() < found.max() - 0.15
    assert np.isnan(cells.agreement(target, np.array([[390, 390]]))).all()


def test_too_little_ground_agrees_with_nothing() -> None:
    target = colour_map(lawns(60), np.ones((60, 60), bool))
    small = np.zeros((SIDE, SIDE), bool)
    small[100:103, 100:103] = True
    cells = ground_cells(smoothed_layers(ground_layers(lawns(SIDE), small), 0.5), 0.5, 0.0, 100)
    assert np.isnan(cells.agreement(target, np.array([[0, 0]]))).all()


def test_moved_cells_are_on_the_border_where_they_leave_the_layer() -> None:
    layer = np.arange(12).reshape(3, 4) + 1
    at = moved_cells(np.array([[0, 0], [3, 2]]), np.array([[0, 0], [-1, 0], [0, 1], [40, -40], [1, 1]]), layer.shape)
    assert np.pad(layer, 1).take(at).tolist() == [[1, 12], [0, 11], [5, 0], [0, 0], [6, 0]]
