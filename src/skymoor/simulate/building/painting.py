# SPDX-License-Identifier: Apache-2.0
"""The page of one wall: its material, a painted ground floor on some, and its age."""

from __future__ import annotations

import numpy as np

from skymoor.simulate.building.kit import BELOW_M, wall_colour
from skymoor.simulate.building.materials import Array32, Rng, centres, noise, octaves, wall_texture
from skymoor.simulate.building.openings import Opening, bays, rects, wall_lengths
from skymoor.simulate.building.weathering import age, tide_mark
from skymoor.simulate.mesh import Array, stream
from skymoor.simulate.plan import Building


def painted_wall(
    building: Building, wall: int, openings: tuple[Opening, ...], top_m: float, texel_m: float
) -> tuple[Array32, float]:
    """The page (h, w, 3) of a wall up to `top_m`, and its texel; of one bay only where bays repeat."""
    length = float(wall_lengths(building)[wall])
    rng = stream(building.looks, "wall", 0 if building.repeated else wall)
    holes = rects(openings)
    if building.repeated:
        length = float(bays(building, length, rng)[1])
        texel_m = length / np.ceil(length / texel_m)
        holes = holes[holes[:, 2] < length]
    shape = int(np.ceil((top_m + BELOW_M) / texel_m)), round(np.ceil(length / texel_m - 1e-6))
    albedo = wall_texture(building.wall, rng, shape, texel_m, wall_colour(building))
    _ground_floor(albedo, building, texel_m, top_m)
    strength = float(stream(building.looks, "age").uniform(0.6, 1.3))
    age(albedo, rng, texel_m, top_m, holes, strength * (0.7 if building.wall == "metal" else 1.0))
    if building.water_up is not None:
        tide_mark(albedo, rng, texel_m, top_m, building.water_up - building.up)
    return np.clip(albedo, 0.02, 0.7), texel_m


def _ground_floor(albedo: Array32, building: Building, texel_m: float, top_m: float) -> None:
    """On some buildings the ground floor has another paint, a little worn."""
    rng = stream(building.looks, "ground floor")
    if building.storeys < 2 or rng.random() > 0.45:
        return
    tone = rng.uniform(0.55, 1.25) * rng.uniform(0.93, 1.07, 3)
    level = float(building.storey_m - 0.2)
    y, _ = centres((albedo.shape[0], albedo.shape[1]), texel_m)
    below = np.clip((level - (top_m - y)) / texel_m, 0, 1)
    worn = np.clip(0.95 + 0.15 * noise(rng, (albedo.shape[0], albedo.shape[1]), texel_m, 0.5), 0, 1)
    albedo *= 1 + (below * worn)[..., None] * (tone.astype(np.float32) - 1)


def flat_colour(rng: Rng, colour: Array, shape: tuple[int, int], texel_m: float) -> Array32:
    """A page of one colour with blotches, for walls that are only seen from far away."""
    shade = 1 + octaves(rng, shape, texel_m, 0.05, smallest_m=0.2)
    page: Array32 = shade[..., None] * colour.astype(np.float32)
    return page
