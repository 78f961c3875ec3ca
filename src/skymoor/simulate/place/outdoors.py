# SPDX-License-Identifier: Apache-2.0
"""Where trees grow and where tanks, containers, lamps and the like stand."""

from __future__ import annotations

import numpy as np

from skymoor.simulate.mesh import rectangle, stream
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.place.land import Land
from skymoor.simulate.place.occupied import Occupied, placed
from skymoor.simulate.plan import Array, Building


def plant_trees(options: SiteOptions, land: Land, ground: Occupied, extent: float, walked: list[Building]) -> Array:
    """Single trees and groves; fewer at industrial sites. Some stand before the facades that people photograph."""
    rng = stream(options.key, "trees")
    density = {"office-park": 24.0, "industrial": 9.0, "flooded": 28.0, "hillside": 26.0}[options.preset]  # per hectare
    count = int(density * (2 * extent / 100) ** 2)
    groves = rng.uniform(-extent, extent, (max(count // 25, 4), 2))
    near = rng.uniform(size=count) < 0.55
    plan = np.where(
        near[:, None],
        groves[rng.integers(len(groves), size=count)] + rng.normal(scale=11, size=(count, 2)),
        rng.uniform(-extent, extent, (count, 2)),
    )
    for building in walked:
        outline = np.array(building.outline)
        side = rng.uniform(outline.min(axis=0) - 5, outline.max(axis=0) + 5, (6, 2))
        plan = np.concatenate([plan, placed(side, building.east, building.north, building.heading_deg)])
    trees = []
    for (e, n), height in zip(plan, rng.uniform(4.5, 12.5, len(plan)), strict=True):
        radius = height * rng.uniform(0.24, 0.36)
        if ground.free(placed(rectangle(2.2, 2.2), e, n, 0)) and not land.wet(e, n):
            trees.append((e, n, height, radius))
            ground.take(placed(rectangle(1.5, 1.5), e, n, 0))
    return np.array(trees).reshape(-1, 4)


def put_props(options: SiteOptions, land: Land, ground: Occupied) -> tuple[tuple[str, float, float, float], ...]:
    """Tanks, containers, lamps and the like, within the radius."""
    rng = stream(options.key, "props")
    area = (2 * options.radius_m / 100) ** 2
    kinds = {
        "office-park": (("lamp", 9, 0.6), ("bench", 4, 1.2), ("hedge", 7, 2.5), ("bin", 4, 0.6), ("shed", 1.5, 2.5)),
        "industrial": (
            ("tank", 3, 6.5),
            ("silo", 2.5, 3.2),
            ("container", 14, 4.0),
            ("lamp", 6, 0.6),
            ("pallets", 14, 1.6),
            ("pipes", 4, 7.0),
            ("hedge", 2, 2.5),
        ),
        "flooded": (("lamp", 5, 0.6), ("hedge", 6, 2.5), ("bench", 3, 1.2), ("shed", 3, 2.5), ("container", 2, 4.0)),
        "hillside": (("lamp", 7, 0.6), ("hedge", 9, 2.5), ("bench", 4, 1.2), ("shed", 4, 2.5), ("bin", 3, 0.6)),
        "old-houses": (("lamp", 6, 0.6), ("hedge", 10, 2.5), ("bench", 4, 1.2), ("shed", 7, 2.5), ("bin", 5, 0.6)),
    }[options.preset]
    props: list[tuple[str, float, float, float]] = []
    for kind, per_hectare, half in kinds:
        for _ in range(int(per_hectare * area) * 4):
            e, n = rng.uniform(-options.radius_m, options.radius_m, 2)
            heading = float(rng.uniform(0, 360))
            outline = placed(rectangle(2 * half, 2 * half), e, n, heading)
            if sum(p[0] == kind for p in props) < per_hectare * area and ground.free(outline) and not land.wet(e, n):
                ground.take(outline)
                props.append((kind, float(e), float(n), heading))
    return tuple(props)
