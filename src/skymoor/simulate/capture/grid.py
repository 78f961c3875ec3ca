# SPDX-License-Identifier: Apache-2.0
"""A flight for mapping: strips at one height, all cameras tilted forward by a little."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from skymoor.geometry import Intrinsics, Similarity
from skymoor.simulate.capture.aim import looking, standing_at

Array = NDArray[np.float64]

HEIGHT_M = (60.0, 100.0)
OVERLAP_ALONG, OVERLAP_ACROSS = 0.75, 0.65  # of the footprints; more where the photos are more than the site needs
CROSSING = 20  # photos from which on a second set of strips crosses the first one
TILT_JITTER_DEG, LEAN_JITTER_DEG, YAW_JITTER_DEG = 2.0, 1.0, 2.0
PLACE_JITTER_M = 1.0


def grid_poses(
    rng: np.random.Generator, lens: Intrinsics, count: int, middle: Array, radius_m: float, tilt_deg: float
) -> list[Similarity]:
    """Poses in the order of flight over `middle` (3,), which lies on the ground."""
    up_m, heading = float(rng.uniform(*HEIGHT_M)), float(rng.uniform(0, 360))
    crossing = count // 2 if count >= CROSSING else 0
    poses: list[Similarity] = []
    for number, turn in ((count - crossing, 0.0), (crossing, 90.0)):
        poses += _strips(rng, lens, number, middle, up_m, radius_m, heading + turn, tilt_deg)
    return poses


def _strips(
    rng: np.random.Generator,
    lens: Intrinsics,
    count: int,
    middle: Array,
    up_m: float,
    radius_m: float,
    heading: float,
    tilt_deg: float,
) -> Iterator[Similarity]:
    """A serpentine of strips `up_m` over `middle` (3,), the first one towards `heading`."""
    if not count:
        return
    along = (1 - OVERLAP_ALONG) * up_m * lens.height / lens.fy
    across = (1 - OVERLAP_ACROSS) * up_m * lens.width / lens.fx
    rows = max(round(np.sqrt(count * along / across)), 1)
    columns = -(-count // rows)
    along = min(along, 2 * radius_m / max(columns - 1, 1))
    across = min(across, 2 * radius_m / max(rows - 1, 1))
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    for k in range(count):
        row, column = divmod(k, columns)
        back = row % 2 == 1
        x = (row - (rows - 1) / 2) * across
        y = ((columns - 1 - column if back else column) - (columns - 1) / 2) * along
        plan = np.array([c * x + s * y, c * y - s * x]) + rng.normal(scale=PLACE_JITTER_M, size=2)
        centre = middle + [*plan, up_m + rng.normal(scale=0.5 * PLACE_JITTER_M)]
        yaw, tilt, lean = rng.normal(scale=(YAW_JITTER_DEG, TILT_JITTER_DEG, LEAN_JITTER_DEG))
        rotation = looking(heading + (180 if back else 0) + yaw, -90 + max(tilt_deg + tilt, 0.0))
        # A lean to the side of a camera that looks down is a turn about its own y axis.
        c_lean, s_lean = np.cos(np.radians(lean)), np.sin(np.radians(lean))
        yield standing_at(centre, np.array([[c_lean, 0, s_lean], [0, 1, 0], [-s_lean, 0, c_lean]]) @ rotation)
