# SPDX-License-Identifier: Apache-2.0
"""Figure of a ground registration: the same walls from ground photos and from airborne photos."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.walls.airborne import AirborneWalls, GroundOptions
from skymoor.ground.walls.facade_pairs import FacadePair, pair_facades
from skymoor.types import DepthMap, Image

GAP_PX = 6


def walls_figure(
    maps_level: Sequence[DepthMap],
    airborne: AirborneWalls,
    enu_from_level: Similarity,
    options: GroundOptions | None = None,
    *,
    count: int = 4,
    width: int = 1200,
) -> Image | None:
    """The largest common walls, one below the other: from ground photos, from airborne photos, in alternate squares.

    None where no photo shows an airborne wall.
    """
    options = options or GroundOptions()
    maps = list(maps_level)
    pairs = pair_facades(airborne.facades, airborne.heights, maps, enu_from_level, options.facade_pairs)
    largest = sorted(pairs, key=lambda pair: -int((pair.ground.mask & pair.airborne.mask).sum()))[:count]
    rows = [_row(pair, width) for pair in largest]
    return np.concatenate(rows) if rows else None


def _row(pair: FacadePair, width: int) -> Image:
    shown = pair.ground.mask | pair.airborne.mask
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    images = [np.where(r.mask[..., None], r.rgb, 40).astype(np.uint8)[window] for r in (pair.ground, pair.airborne)]
    h, w = images[0].shape[:2]
    cell = max(8, h // 5)
    v, u = np.mgrid[:h, :w] // cell
    mixed = np.where(((u + v) % 2 == 0)[..., None], *images)
    each = (width - 2 * GAP_PX) // 3
    height = max(1, round(h * each / w))
    gap = np.full((height, GAP_PX, 3), 255, np.uint8)
    parts = [cv2.resize(part, (each, height), interpolation=cv2.INTER_AREA) for part in (*images, mixed)]
    row = np.concatenate([parts[0], gap, parts[1], gap, parts[2]], axis=1)
    return np.concatenate([row, np.full((GAP_PX, row.shape[1], 3), 255, np.uint8)])
