# SPDX-License-Identifier: Apache-2.0
"""A simulated site: everything that is the same every day, and the scene of each day."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from skymoor.simulate.building.assemble import daily_parts, fixed_parts
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import Label, Part, join, stream
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.place.cars import cars
from skymoor.simulate.place.ground import paint_ground
from skymoor.simulate.place.land import terrain, water
from skymoor.simulate.place.layout import Plan, make_plan
from skymoor.simulate.place.noise import periodic
from skymoor.simulate.place.plants import hedge, trees
from skymoor.simulate.place.props import props
from skymoor.simulate.plan import Array, Array32, Date

NEAR_MARGIN_M = 15.0  # of finely painted ground around the site
NEAR_TEXEL_M, FAR_TEXEL_M = 0.06, 0.35


@dataclass(frozen=True)
class World:
    """A site as its options make it. Two worlds of equal options are the same, whatever has been built of them."""

    options: SiteOptions

    @cached_property
    def plan(self) -> Plan:
        """What stands where."""
        return make_plan(self.options)

    def height(self, east: Array, north: Array) -> Array:
        """Up of the ground (or of the pond's bed) at plan positions of any shape, metres."""
        return self.plan.land.height(east, north)

    def scene(self, date: Date) -> Scene:
        """The site on a day. Scenes are large; the two last ones are kept."""
        return _scene(self, date)

    @cached_property
    def _fixed(self) -> tuple[Part, Pages]:
        """Buildings and what else never moves."""
        pages, seed = Pages(), self.options.key
        parts = [fixed_parts(building, pages) for building in (*self.plan.buildings, *self.plan.distractors)]
        parts.append(props(self.plan, pages, seed))
        return join(parts), pages


@lru_cache(maxsize=2)
def _scene(world: World, date: Date) -> Scene:
    options, plan = world.options, world.plan
    fixed, pages = world._fixed
    pages = pages.copy()
    near_m = options.radius_m + NEAR_MARGIN_M
    near = pages.add(paint_ground(plan, options.key, date.season, near_m, NEAR_TEXEL_M), NEAR_TEXEL_M)
    far = pages.add(paint_ground(plan, options.key, date.season, plan.extent_m, FAR_TEXEL_M), FAR_TEXEL_M)
    daily = [daily_parts(building, pages, date.name, ground=plan.land.height) for building in plan.buildings]
    trunks, crowns = trees(plan.trees, plan.land, options.radius_m, date.season, options.key, fine=options.real)
    hedges = [
        hedge(
            np.array([east, north]),
            heading,
            plan.land,
            date.season,
            stream(options.key, "hedge", k),
            tall=kind == "tall hedge",
        )
        for k, (kind, east, north, heading) in enumerate(plan.props)
        if kind in ("hedge", "tall hedge")
    ]
    ground = terrain(plan.land, near_m, plan.extent_m, near, far)
    solid = [ground, water(plan.land), fixed, *daily, trunks, cars(plan, options.key, date.name)]
    rng = stream(options.key, "air", date.name)
    roofs = max((b.up + b.walls_m for b in plan.buildings), default=5.0)
    low = float(fixed.corners[fixed.label == Label.WALL][..., 2].min()) if len(fixed) else 0.0
    return Scene(
        solid=join(solid),
        leafy=join([crowns, *hedges]),
        pages=pages,
        grain=pages.add(_grain(stream(options.key, "grain")), 0.006),
        sun=date.sun,
        clouds=np.clip(0.35 * periodic(rng, 512, 3, 1.7) - 0.05, 0, 0.85),
        haze_per_m=date.haze,
        ripples=_ripples(rng),
        lattice=(near_m, low, roofs + 3),
    )


def _ripples(rng: np.random.Generator) -> Array32:
    """Slopes (256, 256, 2) of water in a light wind, new on each day."""
    level = periodic(rng, 256, 2, 1.3)
    slopes = np.stack([np.roll(level, 1, axis=k) - np.roll(level, -1, axis=k) for k in (1, 0)], axis=-1)
    return np.asarray(0.035 * slopes / slopes.std(), dtype=np.float32)


def _grain(rng: np.random.Generator) -> Array32:
    """Fine grain (1024, 1024, 3) of mean one half; the green channel is coarser, for grass."""
    blades = 0.5 * np.exp(0.12 * periodic(rng, 1024, 1.5, 0.7))
    tufts = 0.5 * np.exp(0.3 * periodic(rng, 1024, 2.5, 1.0))
    grey = np.clip(np.stack([blades, tufts, blades], axis=-1), 0, 1)
    return np.asarray(grey, dtype=np.float32)
