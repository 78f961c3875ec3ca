# SPDX-License-Identifier: Apache-2.0
"""Nodata that a DSM does not declare: heights that no land has, and plateaus of one value with a cliff all round."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy  # its parts load when they are first used
from numpy.typing import NDArray
from rasterio.enums import MaskFlags
from rasterio.io import DatasetReader

from skymoor.errors import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# No land is below -430 m (Dead Sea) or above 8850 m (Everest). Where heights are above the ellipsoid, the geoid adds
# -107 to 86 m; what is left of the margins are mines and masts. 9999 and -999 are outside.
HEIGHT_RANGE_M = (-550.0, 9000.0)
# What programs write into pixels without a height, in the numbers of the file.
SENTINELS = (0, -1, -99, -999, -9999, -99999, 999, 9999, 99999, -32767, -32768, 32767, 65535)
# Smaller plateaus are flat roofs, ponds and chance.
MIN_PLATEAU_PX = 16
# Shares of the border that must be a cliff, and of the other pixels that the largest of their steps leave out.
ALL_ROUND, STEEPEST = 0.95, 0.99
# Quays, locks and basins fall by less to their exactly level water.
MIN_CLIFF_M = 10.0
# For the least value of a raster that is no usual sentinel: so far below all else is no basin, mine or shaft. And for a
# value of most pixels: walls that rise from the level ground of a simple scene are cliffs all round too, but lower.
MIN_GAP_M = 100.0
# Among simulated boxes and footprints with one height each, a wall is a cliff; their roofs hardly have any steps.
MIN_ROUGH = 0.1


@dataclass(frozen=True, eq=False)
class Sampled:
    """Heights (h, w) that were sampled from a DSM in metres above its datum, and how far apart the samples are.

    `scale` and `offset` give metres of a number in the file.
    """

    heights: Array
    spacing_m: float
    scale: float = 1.0
    offset: float = 0.0

    def number(self, height_m: float) -> float:
        """What the file holds for a height."""
        return (height_m - self.offset) / self.scale


def require_on_earth(path: Path, heights: Array, unit_m: float) -> None:
    """Raise `InputError` where heights (any shape), times the metres of their unit, are outside of `HEIGHT_RANGE_M`."""
    metres = heights[np.isfinite(heights)] * unit_m
    impossible = metres[(metres < HEIGHT_RANGE_M[0]) | (metres > HEIGHT_RANGE_M[1])]
    if impossible.size:
        raise InputError(
            f"{path}: {impossible.size} heights are impossible, such as {impossible[0] / unit_m:g}; declare that "
            "nodata value (gdal_edit -a_nodata), or convert the heights to metres or set their unit (gdal_edit -units)"
        )


def require_declared_nodata(path: Path, source: DatasetReader, sampled: Sampled) -> None:
    """Raise `InputError` where a DSM without a declared nodata value or mask has a plateau that must be nodata."""
    if MaskFlags.all_valid not in source.mask_flag_enums[0]:
        return
    found = undeclared_nodata(sampled)
    if found is None:
        return
    value, share = found
    raise InputError(
        f"{path}: {share:.1%} of its heights are {value:g}, a plateau with a cliff all round, so nodata that is not "
        f"declared; declare it (gdal_edit -a_nodata {value:g}), or, if {value:g} is a real height, any other value"
    )


def undeclared_nodata(sampled: Sampled) -> tuple[float, float] | None:
    """The number in the file that is nodata although it is a possible height, and its share of the heights; or None.

    A value is nodata where it forms plateaus (connected, exactly equal) and nearly everywhere around them the surface
    breaks off: by at least `MIN_CLIFF_M`, by more than 45 degrees, and by twice what nearly all neighbours differ by in
    the rest. Lakes and the sea are level too, but have shores, and beside a steep shore the slope goes on. Only a usual
    sentinel, or a value far below all else, is suspected: roofs are level with cliffs, but rise among other heights.
    The border is taken two pixels outside, because resampling mixes the first with the plateau. One value everywhere
    is a valid height.
    """
    heights = sampled.heights
    known = np.isfinite(heights)
    for value in _suspects(sampled, known):
        plateau = _large_parts(heights == value)
        near, beyond = (scipy.ndimage.binary_dilation(plateau, np.ones((n, n))) for n in (3, 5))
        border, rest = known & beyond & ~near, known & ~near
        if not plateau.any() or border.sum() < MIN_PLATEAU_PX:
            continue
        cliff = float(np.quantile(np.abs(heights[border] - value), 1.0 - ALL_ROUND))
        steps = _steps(heights, rest)
        if not steps.size or np.mean(steps > 0) < MIN_ROUGH:
            continue
        share = float(plateau.sum() / known.sum())
        least = MIN_CLIFF_M if share < 0.5 else MIN_GAP_M
        if cliff >= max(least, sampled.spacing_m, 2.0 * float(np.quantile(steps, STEEPEST))):
            return round(float(sampled.number(value)), 6), share
    return None


def _suspects(sampled: Sampled, known: Mask) -> Iterator[float]:
    """Values that occur often enough: usual sentinels, and the least one where it is far below all else."""
    values, counts = np.unique(sampled.heights[known], return_counts=True)
    often = counts >= MIN_PLATEAU_PX
    numbers = (values - sampled.offset) / sampled.scale
    usual = np.isclose(numbers[:, None], SENTINELS, rtol=1e-6, atol=1e-6).any(axis=1)
    least = np.zeros_like(usual)
    if len(values) > 1:
        low, high = np.quantile(sampled.heights[known & (sampled.heights > values[0])], [0.01, 0.99])
        least[0] = low - values[0] >= max(MIN_GAP_M, high - low)
    yield from values[often & (usual | least)]


def _large_parts(plateau: Mask) -> Mask:
    labels, _ = scipy.ndimage.label(plateau, np.ones((3, 3)))
    large = np.bincount(labels.ravel()) >= MIN_PLATEAU_PX
    large[0] = False
    parts: Mask = large[labels]
    return parts


def _steps(heights: Array, use: Mask) -> Array:
    """Absolute differences (n,) of neighbours in rows and columns that are both in use."""
    down, across = np.abs(np.diff(heights, axis=0)), np.abs(np.diff(heights, axis=1))
    return np.concatenate([down[use[1:] & use[:-1]], across[use[:, 1:] & use[:, :-1]]])
