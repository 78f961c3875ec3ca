# SPDX-License-Identifier: Apache-2.0
"""All shifts of a pose at once, by correlation of the pictures of walls by FFT (Padfield 2012).

Local refinement ends a few metres aside where walls repeat themselves. A shift moves the picture of a wall along the
wall and upwards, and enlarges it as the photos come nearer. So, from pictures at a few distances, the sums of which the
agreement with all walls consists are read from correlations for every shift.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from skymoor.ground.walls.consensus import agreement_in_both
from skymoor.ground.walls.facades import Facade
from skymoor.match.channels import N_COLOUR, Channels
from skymoor.match.correlate import Target
from skymoor.types import Array

WallPictures = Sequence[tuple[Facade, Channels, Target]]
"""Walls with the channels of their pictures from the ground and from the air, on one grid."""


@dataclass(frozen=True)
class ShiftOptions:
    """Shifts around a hypothesis that are compared, in metres.

    Attributes:
        reach_m, reach_up_m: the largest ones in plan and in height.
        step_m: their spacing.
        distance_step_m: spacing of the distances at which walls are depicted.
    """

    reach_m: float = 3.0
    reach_up_m: float = 1.5
    step_m: float = 0.25
    distance_step_m: float = 1.5


@dataclass(frozen=True, eq=False)
class PoseEvidence:
    """What shifts of a pose are compared by.

    `pictures` of its walls if the model were so many metres further out along the normal of each; `in_plan`, scores
    (n,) of shifts (n, 2), east and north, NaN where unknown; `unusual`, what is taken off where it is raised by (m,)
    metres.
    """

    pictures: Callable[[float], WallPictures]
    in_plan: Callable[[Array], Array]
    unusual: Callable[[Array], Array]


def best_shift(evidence: PoseEvidence, options: ShiftOptions | None = None) -> Array:
    """The shift (3,), east, north and up, at which pictures and plan agree best."""
    options = options or ShiftOptions()
    steps, up = (_steps(reach, options.step_m) for reach in (options.reach_m, options.reach_up_m))
    east_north = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    scores = agreement_of_shifts(evidence.pictures, east_north, up, _steps(options.reach_m, options.distance_step_m))
    value = agreement_in_both(scores, evidence.in_plan(east_north)[:, None]) - evidence.unusual(up)
    i, j = np.unravel_index(int(np.argmax(value)), value.shape)
    return np.array([*east_north[i], up[j]])


def agreement_of_shifts(
    pictures: Callable[[float], WallPictures], east_north: Array, up: Array, outwards: Array
) -> Array:
    """Scores (n, m), as of `agreement_of_channels`, of all shifts east_north (n, 2) with all shifts up (m,), metres.

    Args:
        pictures: see `PoseEvidence`; taken at the distances `outwards` (k,), and used for the shifts next to them.
        east_north, up: the shifts.
        outwards: ascending.
    """
    sums = np.zeros((4, len(east_north), len(up)))
    for k, distance in enumerate(outwards.tolist()):
        for facade, ground, airborne in pictures(distance):
            shifts = east_north @ facade.wall.normal
            near = np.flatnonzero(np.abs(shifts[:, None] - outwards).argmin(axis=1) == k)
            if not len(near):
                continue
            along = np.round(east_north[near] @ facade.wall.right / facade.pixel_m).astype(int)
            down = np.round(-up / facade.pixel_m).astype(int)
            reach = int(np.abs(down).max()), int(np.abs(along).max())
            maps = _sums_of_shifts(ground, airborne, reach)
            sums[:, near] += maps[:, (down + reach[0])[None, :], (along + reach[1])[:, None]]
    numerator, energy_a, energy_b, pixels = sums
    ncc = numerator / np.maximum(np.sqrt(np.maximum(energy_a * energy_b, 0.0)), 1e-6)
    return np.asarray(ncc * np.sqrt(np.maximum(pixels, 0.0)))


def _sums_of_shifts(ground: Channels, airborne: Target, reach: tuple[int, int]) -> Array:
    """Product, both energies and number of shared pixels (4, 2 rows + 1, 2 columns + 1) of the ground's picture shifted
    down and right by up to `reach` rows and columns.
    """
    size = [n + r for n, r in zip(ground.known.shape[1:], reach, strict=True)]
    padded = fft.next_fast_len(size[0], real=True), fft.next_fast_len(size[1], real=True)
    values, known = ground.values[:N_COLOUR], ground.known[:1]
    own = np.conj(fft.rfft2(np.concatenate([values, (values**2).sum(axis=0)[None], known]), s=padded))
    other = airborne.spectra(padded)
    products = np.stack(
        [
            (own[:N_COLOUR] * other[:N_COLOUR]).sum(axis=0),
            own[-2] * other[-1],
            own[-1] * other[-2],
            own[-1] * other[-1],
        ]
    )
    maps = fft.irfft2(products, s=padded)
    rows, columns = (np.arange(-r, r + 1) % n for r, n in zip(reach, padded, strict=True))
    return np.asarray(maps[:, rows][:, :, columns])


def _steps(reach: float, step: float) -> Array:
    count = int(np.floor(reach / step + 1e-9))
    return np.asarray(step * np.arange(-count, count + 1))
