# SPDX-License-Identifier: Apache-2.0
"""Light from the sky: its colours, its clouds, and how much of it reaches a place between buildings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, maximum_filter

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

ZENITH = np.array([0.22, 0.40, 0.75], dtype=np.float32)
HORIZON = np.array([0.72, 0.80, 0.88], dtype=np.float32)
CLOUD = np.array([0.95, 0.95, 0.96], dtype=np.float32)
SUNLIGHT = np.array([1.0, 0.94, 0.84], dtype=np.float32)
SKYLIGHT = np.array([0.30, 0.35, 0.43], dtype=np.float32)
BOUNCE = np.array([0.15, 0.14, 0.12], dtype=np.float32)


def sky_colours(directions: Array32, sun: Array, clouds: Array32) -> Array32:
    """Radiance (n, 3) of the sky along unit directions (n, 3); `clouds` (h, w) is a periodic field in [0, 1]."""
    up = np.maximum(directions[:, 2], 0.0)
    share = np.exp(-3.5 * up)[:, None]
    colour = share * HORIZON + (1 - share) * ZENITH
    # A layer at one height: clouds grow smaller towards the horizon, and the haze takes them there.
    plan = directions[:, :2] / np.maximum(up, 0.05)[:, None]
    size = clouds.shape[0]
    row, column = ((np.mod(plan[:, k] * 0.12, 1.0) * size).astype(np.int32) % size for k in (0, 1))
    cover = (clouds[row, column] * np.clip(up * 5, 0, 1))[:, None]
    colour = colour * (1 - cover) + CLOUD * cover
    glow = np.maximum(directions @ sun.astype(np.float32), 0.0) ** 64
    return np.asarray(colour + 0.6 * glow[:, None] * SUNLIGHT, dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Openness:
    """Share of the upper hemisphere that is free, on a lattice of `step_m`, first node at `origin` (3,)."""

    origin: Array
    step_m: float
    share: Array32

    def at(self, points: Array32, normals: Array32) -> Array32:
        """Openness (n,) a little before surfaces at (n, 3); 1 outside of the lattice."""
        start = points + 0.6 * self.step_m * normals
        index = ((start - self.origin.astype(np.float32)) / np.float32(self.step_m)).T
        return np.asarray(map_coordinates(self.share, index, order=1, mode="constant", cval=1.0), dtype=np.float32)


def measure_openness(
    occluded: Callable[[Array32, Array32], NDArray[np.bool_]],
    radius_m: float,
    low_m: float,
    high_m: float,
    *,
    step_m: float = 1.5,
    directions: int = 24,
    reach_m: float = 60.0,
) -> Openness:
    """Cast rays from each node of a lattice over the site; `occluded(origins, directions)` looks as far as they reach.

    What `occluded` counts is up to it: leaves should be left out, or trees would darken like rocks.
    """
    side = np.arange(-radius_m, radius_m + step_m, step_m)
    ups = np.arange(low_m, high_m + step_m, step_m)
    nodes = np.stack(np.meshgrid(side, side, ups, indexing="ij"), axis=-1).astype(np.float32)
    flat = nodes.reshape(-1, 3)
    parts = np.array_split(flat, max(len(flat) >> 18, 1))
    # A spiral over the hemisphere, weighed by the cosine like light on the ground.
    k = np.arange(directions) + 0.5
    up = np.sqrt(1 - k / directions * 0.97)
    turn = np.pi * (1 + np.sqrt(5)) * k
    spread = np.sqrt(1 - up**2)
    free = np.zeros(len(flat), dtype=np.float32)
    for x, y, z in zip(spread * np.cos(turn), spread * np.sin(turn), up, strict=True):
        ray = np.array([x, y, z], dtype=np.float32) * np.float32(reach_m)
        free += np.concatenate([~occluded(part, ray) for part in parts])
    share = (free / directions).reshape(nodes.shape[:3])
    # Nodes inside walls see nothing; they take what their brightest neighbour sees, or every wall would be dark.
    share = np.where(share < 0.03, maximum_filter(share, size=3), share)
    return Openness(nodes[0, 0, 0].astype(np.float64), step_m, share.astype(np.float32))
