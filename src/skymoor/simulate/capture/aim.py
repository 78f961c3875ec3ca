# SPDX-License-Identifier: Apache-2.0
"""Lenses, and cameras turned to what they look at."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skymoor.geometry import Intrinsics, Similarity
from skymoor.simulate.options import SiteOptions

Array = NDArray[np.float64]


def make_lens(
    options: SiteOptions, rng: np.random.Generator, focal_widths: float, distortion: tuple[float, float, float, float]
) -> Intrinsics:
    """A lens of that focal length; its principal point is 3 to 4.5 pixels per 1000 off the middle, somewhere."""
    width, height = options.photo_width, round(0.75 * options.photo_width)
    turn, off = rng.uniform(0, 2 * np.pi), rng.uniform(0.003, 0.0045) * width
    cx, cy = float(width / 2 + off * np.cos(turn)), float(height / 2 + off * np.sin(turn))
    return Intrinsics(width, height, focal_widths * width, focal_widths * width, cx, cy, distortion)


def looking(azimuth_deg: ArrayLike, pitch_deg: ArrayLike, roll_deg: ArrayLike = 0.0) -> Array:
    """cam_from_enu rotations (..., 3, 3) of cameras that look along an azimuth and upwards by a pitch.

    With a pitch of -90 the top of the picture is towards the azimuth. A positive roll turns the camera clockwise, as
    seen by who holds it.
    """
    azimuth, pitch, roll = np.broadcast_arrays(*(np.radians(x) for x in (azimuth_deg, pitch_deg, roll_deg)))
    east, north = np.sin(azimuth), np.cos(azimuth)
    right = np.stack([north, -east, np.zeros_like(east)], axis=-1)
    ahead = np.stack([east * np.cos(pitch), north * np.cos(pitch), np.sin(pitch)], axis=-1)
    down = np.cross(ahead, right)
    c, s = np.cos(roll)[..., None], np.sin(roll)[..., None]
    return np.stack([c * right + s * down, c * down - s * right, ahead], axis=-2)


def standing_at(centre: ArrayLike, cam_from_enu: Array) -> Similarity:
    """The pose of a camera at `centre` (3,) with that rotation (3, 3)."""
    return Similarity(1.0, cam_from_enu, -cam_from_enu @ np.asarray(centre, dtype=np.float64))


def azimuth_deg(plan: ArrayLike) -> Array:
    """Directions clockwise from north of vectors (..., 2) east, north."""
    vectors = np.asarray(plan, dtype=np.float64)
    return np.asarray(np.degrees(np.arctan2(vectors[..., 0], vectors[..., 1])))
