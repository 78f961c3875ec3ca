# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.match.channels import ChannelOptions, make_channels, rotate_angles, rotate_channels
from skymoor.types import Image, Raster
from support.pictures import noise_picture

Array32 = NDArray[np.float32]
SHAPE = (150, 150)
PLAIN = ChannelOptions()


def raster(rgb: Image, height: Array32 | None = None) -> Raster:
    return Raster(rgb, np.ones(rgb.shape[:2], bool), height)


def hills(shape: tuple[int, int] = SHAPE) -> Array32:
    smooth = cv2.GaussianBlur(np.random.default_rng(9).normal(size=shape).astype(np.float32), (0, 0), 4)
    return np.asarray(4 * smooth / smooth.std(), dtype=np.float32)


def agreement(a: Array32, b: Array32, margin: int = 15) -> float:
    """Normalised correlation of two stacks, without their borders."""
    inner = (slice(None), slice(margin, -margin), slice(margin, -margin))
    x, y = a[inner].ravel().astype(np.float64), b[inner].ravel().astype(np.float64)
    return float(x @ y / np.sqrt((x @ x) * (y @ y)))


def test_reversed_contrast_gives_the_same_colour_channels() -> None:
    rgb = noise_picture(SHAPE)
    positive, negative = make_channels(raster(rgb), PLAIN), make_channels(raster(255 - rgb), PLAIN)
    assert agreement(positive.values[:4], negative.values[:4]) > 0.9


@pytest.mark.parametrize("gamma", [0.5, 2.0])
def test_gamma_and_gain_change_little(gamma: float) -> None:
    rgb = noise_picture(SHAPE)
    other = (30 + 200 * (rgb / 255.0) ** gamma).astype(np.uint8)
    assert agreement(make_channels(raster(rgb), PLAIN).values, make_channels(raster(other), PLAIN).values) > 0.9


def test_another_picture_is_another_place() -> None:
    a, b = (make_channels(raster(noise_picture(SHAPE, seed=k)), PLAIN).values[:4] for k in (0, 1))
    assert abs(agreement(a, b)) < 0.1
    # Two pixels are more than the pooling forgives.
    assert agreement(a, np.roll(a, 4, axis=1)) < 0.5


def test_heights_keep_their_sign() -> None:
    up = make_channels(raster(noise_picture(SHAPE), hills()), PLAIN).values[4:]
    down = make_channels(raster(noise_picture(SHAPE), -hills()), PLAIN).values[4:]
    np.testing.assert_allclose(up, -down, atol=1e-5)
    assert np.abs(up).max() > 0.1


def test_height_channels_point_up_the_slope() -> None:
    ramp = np.tile(0.3 * np.arange(150, dtype=np.float32), (150, 1))
    values = make_channels(raster(noise_picture(SHAPE), ramp), PLAIN).values[4:, 30:-30, 30:-30]
    assert values[0].min() > 0.2
    assert np.abs(values[1]).max() < 1e-4


@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_channels_of_a_picture_turned_by_quarters(quarter: int) -> None:
    rgb, height = noise_picture(SHAPE), hills()
    upright = make_channels(raster(rgb, height), PLAIN)
    # Turning from u towards v is clockwise on the screen, numpy turns the other way.
    turned = make_channels(raster(np.rot90(rgb, -quarter).copy(), np.rot90(height, -quarter).copy()), PLAIN)
    moved = np.stack([np.rot90(x, -quarter) for x in upright.values])
    assert agreement(rotate_angles(moved, quarter * np.pi / 2), turned.values) > 0.999
    if quarter != 2:
        assert agreement(moved, turned.values) < 0.3


@pytest.mark.parametrize("degrees", [30, -75, 160])
def test_turned_channels_are_those_of_the_turned_picture(degrees: float) -> None:
    side = 240
    rgb, height = noise_picture((side, side), sigma_px=3), hills((side, side))
    channels = make_channels(raster(rgb, height), PLAIN)
    turned = rotate_channels(channels, np.radians(degrees))
    size = turned.values.shape[1]
    # OpenCV counts angles the other way round, from the centre of the first pixel.
    matrix = cv2.getRotationMatrix2D((side / 2 - 0.5, side / 2 - 0.5), -degrees, 1.0)
    matrix[:, 2] += size / 2 - side / 2
    picture = cv2.warpAffine(rgb, matrix, (size, size), flags=cv2.INTER_CUBIC)
    heights = cv2.warpAffine(height, matrix, (size, size), flags=cv2.INTER_CUBIC)
    expected = make_channels(raster(picture, heights), PLAIN)
    middle = (slice(None), *(slice(size // 2 - 60, size // 2 + 60),) * 2)
    for group in (slice(0, 4), slice(4, 6)):
        assert agreement(turned.values[middle][group], expected.values[middle][group]) > 0.97


def test_nothing_leaks_out_of_the_mask() -> None:
    rgb, mask = noise_picture(SHAPE), np.ones(SHAPE, bool)
    mask[:, 80:] = False
    height = np.where(mask, hills(), np.nan).astype(np.float32)
    other = rgb.copy()
    other[:, 80:] = 255
    a, b = (make_channels(Raster(x, mask, height), PLAIN) for x in (rgb, other))
    np.testing.assert_array_equal(a.values, b.values)
    assert not a.values[:, :, 80:].any() and not a.known[:, :, 80:].any()
    # The border of the mask is no edge.
    whole = make_channels(Raster(rgb, np.ones(SHAPE, bool), hills()), PLAIN)
    assert np.abs(a.values[:, :, 60:78]).mean() < 1.6 * np.abs(whole.values[:, :, 60:78]).mean()


def test_without_heights_the_height_channels_are_unknown() -> None:
    channels = make_channels(raster(noise_picture(SHAPE)), PLAIN)
    assert not channels.values[4:].any() and not channels.known[1].any()
    assert channels.known[0].any()
    heavy = make_channels(raster(noise_picture(SHAPE), hills()), replace(PLAIN, height_weight=3.0))
    plain = make_channels(raster(noise_picture(SHAPE), hills()), PLAIN)
    np.testing.assert_allclose(heavy.values[4:], 3 * plain.values[4:], rtol=1e-4, atol=1e-6)


def test_a_uniform_picture_has_no_channels() -> None:
    channels = make_channels(raster(np.full((*SHAPE, 3), 90, np.uint8), np.zeros(SHAPE, np.float32)), PLAIN)
    assert np.abs(channels.values).max() < 0.05


def test_scattered_holes_leave_the_rest_known() -> None:
    rgb, rng = noise_picture(SHAPE), np.random.default_rng(3)
    whole = make_channels(raster(rgb), PLAIN)
    mask = np.ones(SHAPE, bool)
    for v, u in rng.integers(3, SHAPE[0] - 3, (600, 2)):  # a hole in every six by six pixels
        mask[v : v + 2, u : u + 2] = False
    holed = make_channels(Raster(np.where(mask[..., None], rgb, 0).astype(np.uint8), mask), PLAIN)
    assert holed.known[0].mean() > 0.9 * whole.known[0].mean()
    assert agreement(holed.values[:4], whole.values[:4]) > 0.7


def test_large_holes_are_unknown_with_their_border() -> None:
    mask = np.ones(SHAPE, bool)
    mask[60:90, 60:90] = False
    known = make_channels(Raster(noise_picture(SHAPE), mask), PLAIN).known[0]
    assert not known[58:92, 58:92].any()
    assert known[56, 56] == 1
