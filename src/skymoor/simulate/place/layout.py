# SPDX-License-Identifier: Apache-2.0
"""Where things stand: roads first, then buildings along them, car parks, trees; nothing on top of another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skymoor.simulate.mesh import rectangle, stream
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.place.blocks import BLOCKS, Block
from skymoor.simulate.place.fronts import NOTHING, put_fronts, varied
from skymoor.simulate.place.gardens import plant_old_trees
from skymoor.simulate.place.land import Land, make_land
from skymoor.simulate.place.occupied import Occupied, grown, placed
from skymoor.simulate.place.outdoors import plant_trees, put_props
from skymoor.simulate.place.terraces import terrace_of
from skymoor.simulate.plan import Array, Building, Strip, Yard

FLOOR_M = 0.1  # of the ground floor above the ground
MIN_EXTENT_M = 260.0  # oblique photos look further than the site
GROUPS_APART_M = 45.0
ROADS_APART_M = {"office-park": 95.0, "industrial": 135.0, "flooded": 150.0, "hillside": 90.0, "old-houses": 75.0}


@dataclass(frozen=True, eq=False)
class Plan:
    """What stands where.

    `buildings` are modelled in full and lie within the radius; `distractors` fill the rest up to `extent_m`.
    `walked` names the buildings that groups of ground photos go round. `trees` (n, 4): east, north, height, crown
    radius. `props` are (kind, east, north, heading) of what stands outdoors for good; `parked` are (east, north,
    heading) of parking places before facades.
    """

    land: Land
    extent_m: float
    buildings: tuple[Building, ...]
    distractors: tuple[Building, ...]
    strips: tuple[Strip, ...]
    yards: tuple[Yard, ...]
    trees: Array
    props: tuple[tuple[str, float, float, float], ...]
    walked: tuple[str, ...]
    barren: float  # how much of the ground is gravel and soil; 0 is a lawn, 1 a yard
    parked: tuple[tuple[float, float, float], ...] = ()

    @property
    def water_up(self) -> float | None:
        """Level of the pond."""
        return self.land.water_up


def make_plan(options: SiteOptions) -> Plan:
    """The plan of a site."""
    extent = max(MIN_EXTENT_M, 0.53 * options.reference_width_m)
    land = make_land(options.preset, options.key, options.radius_m)
    ground = Occupied(extent)
    strips = _roads(options, extent)
    for strip in strips:
        ground.take_line(strip.line, strip.width_m + 5.0)
    buildings, yards = _core(options, land, ground, strips)
    if options.real:
        buildings = tuple(varied(building, options.key) for building in buildings)
    walked = _walked(buildings, options.groups)
    goals = [b for b in buildings if b.name in walked]
    outer, outer_yards = _surroundings(options, land, ground, strips, extent)
    if options.preset == "hillside":
        land = replace(land, terraces=tuple(terrace_of(b, b.up - FLOOR_M) for b in (*buildings, *outer)))
    fronts = put_fronts(buildings, ground, options.key) if options.real else NOTHING
    if options.preset == "old-houses":
        trees = plant_old_trees(options, ground, extent, [*buildings, *outer], strips, goals)
    else:
        trees = plant_trees(options, land, ground, extent, goals)
    trees = np.concatenate([trees, fronts.trees])
    props = (*put_props(options, land, ground), *fronts.hedges)
    barren = 0.75 if options.preset == "industrial" else 0.0
    every = (*yards, *outer_yards)
    return Plan(land, extent, buildings, outer, strips, every, trees, props, walked, barren, fronts.parked)


def _roads(options: SiteOptions, extent: float) -> tuple[Strip, ...]:
    """A street grid that bends: the first of each direction passes near the middle."""
    rng = stream(options.key, "roads")
    heading = rng.uniform(0, 180)
    strips = []
    spacing = ROADS_APART_M[options.preset]
    for turn in (0.0, 90.0):
        direction = np.radians(heading + turn)
        along = np.array([np.cos(direction), np.sin(direction)])
        across = np.array([-along[1], along[0]])
        count = int(1.5 * extent / spacing) + 1
        middle = rng.uniform(-8, 8) if options.preset != "flooded" else 0.62 * options.radius_m
        for k in range(-count, count + 1):
            own = stream(options.key, "road", int(turn), k + 1000)
            offset = middle + spacing * k + (own.uniform(-12, 12) if k else 0.0)
            if k and own.uniform() < 0.25:
                continue
            t = np.arange(-1.45 * extent // 10, 1.45 * extent // 10 + 1) * 10
            bend = offset + own.uniform(4, 9) * np.sin(t / own.uniform(60, 110) + own.uniform(0, 6))
            line = t[:, None] * along + bend[:, None] * across
            width = float(own.choice([6.0, 6.5, 7.5]))
            strips.append(Strip(tuple(map(tuple, line)), width, "road"))
    return tuple(strips)


def _core(
    options: SiteOptions, land: Land, ground: Occupied, strips: tuple[Strip, ...]
) -> tuple[tuple[Building, ...], tuple[Yard, ...]]:
    """Buildings that are modelled in full, each with its yard where there is room."""
    rng = stream(options.key, "buildings")
    blocks, pieces = BLOCKS[options.preset], _pieces(strips)
    wanted = max(int(blocks.per_hectare * (2 * options.radius_m / 100) ** 2), 3)
    buildings: list[Building] = []
    yards: list[Yard] = []
    for attempt in range(4000):
        if len(buildings) >= wanted:
            break
        reach = options.radius_m * (0.75 if attempt < 2000 else 0.95)
        e, n = rng.uniform(-reach, reach, 2)
        block = blocks.draw(rng)
        block = block if attempt < 1500 else block.smaller()
        heading = _heading_at(pieces, e, n) + rng.choice([0, 90, 180, 270]) + rng.normal(scale=1.5)
        if not ground.free(placed(grown(block.outline, 4.0), e, n, heading)):
            continue
        ground.take(placed(grown(block.outline, 2.5), e, n, heading))
        buildings.append(_building(f"B{len(buildings) + 1}", block, e, n, heading, options, land, fine=True))
        more = blocks.yard is not None and len(yards) < wanted * 0.6
        yard = _yard_beside(block, e, n, heading, ground, rng, blocks.yard) if more else None
        yards += [yard] if yard and not land.wet(yard.east, yard.north) else []
    if options.look_alikes == "twins" and len(buildings) > 2:
        buildings = _with_twin(buildings)
    return tuple(buildings), tuple(yards)


def _building(
    name: str, block: Block, e: float, n: float, heading: float, options: SiteOptions, land: Land, *, fine: bool
) -> Building:
    outline = placed(block.outline, e, n, heading)
    around = land.height(outline[:, 0], outline[:, 1])
    # Doors stay free on a slope, which a terrace cuts and fills alike; who stands in the pond stands on its bed.
    level = around.mean() if options.preset == "hillside" else around.min() if land.wet(e, n) else around.max()
    up = float(level) + FLOOR_M
    return Building(
        name=name,
        east=float(e),
        north=float(n),
        up=up,
        heading_deg=float(heading),
        outline=block.outline,
        storeys=block.storeys,
        storey_m=block.storey_m,
        roof=block.roof,
        wall=block.wall,
        cover=block.cover,
        looks=block.looks,
        fine=fine,
        repeated=fine and options.look_alikes != "none",
        water_up=land.water_up if land.wet(e, n) else None,
    )


def _with_twin(buildings: list[Building]) -> list[Building]:
    """The second building becomes the first one again, elsewhere."""
    first = buildings[0]
    far = max(buildings[1:], key=lambda b: np.hypot(b.east - first.east, b.north - first.north))
    twin = replace(
        first,
        name=far.name,
        east=far.east,
        north=far.north,
        up=far.up,
        heading_deg=far.heading_deg,
        water_up=far.water_up,
    )
    return [twin if b is far else b for b in buildings]


def _pieces(strips: tuple[Strip, ...]) -> tuple[Array, Array]:
    """Middles (n, 2) of the straight pieces of all roads, and their directions (n,) in degrees from east."""
    lines = [np.array(strip.line) for strip in strips]
    steps = np.concatenate([np.diff(line, axis=0) for line in lines])
    middles = np.concatenate([(line[1:] + line[:-1]) / 2 for line in lines])
    return middles, np.degrees(np.arctan2(steps[:, 1], steps[:, 0]))


def _heading_at(pieces: tuple[Array, Array], e: float, n: float) -> float:
    """Direction of the nearest road, degrees counter-clockwise from east."""
    middles, headings = pieces
    return float(headings[np.argmin(np.hypot(middles[:, 0] - e, middles[:, 1] - n))])


def _yard_beside(
    block: Block, e: float, n: float, heading: float, ground: Occupied, rng: np.random.Generator, kind: str | None
) -> Yard | None:
    """The first side of a building with room for a car park or a yard."""
    x0, y0 = np.min(block.outline, axis=0)
    x1, y1 = np.max(block.outline, axis=0)
    for turn in rng.permutation([0.0, 90.0, 180.0, 270.0]):
        reach = {0.0: x1, 90.0: y1, 180.0: -x0, 270.0: -y0}[float(turn)]
        length = float((y1 - y0 if turn in (0.0, 180.0) else x1 - x0) * rng.uniform(0.8, 1.2))
        width = float(rng.choice([11.0, 16.5]))
        for shrink in (1.0, 0.7):
            angle = np.radians(heading + turn)
            gap = reach + 4.5 + width / 2
            east, north = e + gap * np.cos(angle), n + gap * np.sin(angle)
            length = max(length * shrink, 12.0)
            outline = placed(rectangle(length, width), east, north, heading + turn + 90)
            if ground.free(outline):
                ground.take(outline)
                return Yard(
                    east, north, heading + turn + 90, length, width, "parking" if kind == "parking" else "concrete"
                )
    return None


def _walked(buildings: tuple[Building, ...], count: int) -> tuple[str, ...]:
    """Buildings for the ground groups: twins first, then the innermost; far apart so that no photo joins two groups."""
    looks = [building.looks for building in buildings]
    order = sorted(buildings, key=lambda b: (-looks.count(b.looks), np.hypot(b.east, b.north) - 6 * b.storeys))
    chosen: list[Building] = []
    for apart in (GROUPS_APART_M, 30.0, 15.0):
        for building in order:
            clear = all(np.hypot(building.east - c.east, building.north - c.north) > apart for c in chosen)
            if len(chosen) < count and clear and building not in chosen:
                chosen.append(building)
    return tuple(building.name for building in chosen)


def _surroundings(
    options: SiteOptions, land: Land, ground: Occupied, strips: tuple[Strip, ...], extent: float
) -> tuple[tuple[Building, ...], tuple[Yard, ...]]:
    """Plainer buildings and yards in the rest: other places for a matcher to fall for."""
    rng = stream(options.key, "surroundings")
    blocks, pieces = BLOCKS[options.preset], _pieces(strips)
    count = int(0.55 * blocks.per_hectare * ((2 * extent) ** 2 - (2 * options.radius_m) ** 2) / 1e4)
    found: list[Building] = []
    yards: list[Yard] = []
    for _ in range(12 * count):
        if len(found) >= count:
            break
        e, n = rng.uniform(-0.97 * extent, 0.97 * extent, 2)
        block = blocks.draw(rng)
        heading = _heading_at(pieces, e, n) + rng.choice([0, 90]) + rng.normal(scale=2)
        if max(abs(e), abs(n)) < options.radius_m + 12 or not ground.free(
            placed(grown(block.outline, 3), e, n, heading)
        ):
            continue
        ground.take(placed(grown(block.outline, 2), e, n, heading))
        found.append(_building(f"D{len(found) + 1}", block, e, n, heading, options, land, fine=False))
        more = blocks.yard is not None and rng.uniform() < 0.5
        yard = _yard_beside(block, e, n, heading, ground, rng, blocks.yard) if more else None
        yards += [yard] if yard else []
    return tuple(found), tuple(yards)
