# SPDX-License-Identifier: Apache-2.0
"""Buildings as triangles: walls with their openings, fittings and roofs, put together and put into their place."""

from __future__ import annotations

import numpy as np

from skymoor.simulate.building.coarse import coarse_parts
from skymoor.simulate.building.daily import Ground, day_things
from skymoor.simulate.building.doors import doors
from skymoor.simulate.building.facades import Face, bands, infills, on_its_side, wall_face, windows
from skymoor.simulate.building.fittings import fittings, room_on
from skymoor.simulate.building.kit import Kit, make_kit, texel_m
from skymoor.simulate.building.openings import is_hall, openings_of, role, wall_lengths
from skymoor.simulate.building.painting import painted_wall
from skymoor.simulate.building.roofs import parapet_m, profile, roof_part
from skymoor.simulate.building.rooftop import rooftop
from skymoor.simulate.building.solids import solid
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.mesh import Array, Part, join, stream
from skymoor.simulate.plan import Building

BROKEN_SHARE = 0.18
"""Panes that a flood has broken."""


def fixed_parts(building: Building, pages: Pages) -> Part:
    """All of a building that stays from day to day, in the site's frame; its textures are added to `pages`.

    A flat roof lies `Building.walls_m` over the ground floor, behind a parapet of 0.3 to 0.9 m; walls go down to
    2.5 m below it. Raises InputError for a pitched roof on an outline that is no rectangle.
    """
    if not building.fine:
        return _placed(coarse_parts(building, pages), building)
    kit = make_kit(building, pages)
    tops = [float(profile(building, wall)[:, 1].max()) for wall in range(len(building.outline))]
    texel = texel_m(building, float(np.mean(tops)))
    walls = [on_its_side(_wall(building, wall, kit, pages, texel), building, wall) for wall in range(len(tops))]
    whole = join([*walls, roof_part(building, kit, pages, 1.5 * texel), rooftop(building, kit, pages)])
    return _placed(solid(whole), building)


def daily_parts(building: Building, pages: Pages, day: str, *, ground: Ground | None = None) -> Part:
    """What changes between days: blinds, gates, bills, and things that stand before the walls.

    `ground` gives heights (n,) of the ground at east, north (n,); without it things stand as high as the ground floor.
    """
    if not building.fine:
        return join([])
    angle = np.radians(building.heading_deg)
    c, s = np.cos(angle), np.sin(angle)

    def level(x: Array, y: Array) -> Array:
        if ground is None:
            return np.zeros_like(x)
        return ground(building.east + c * x - s * y, building.north + s * x + c * y) - building.up

    return _placed(day_things(building, pages, day, level), building)


def _wall(building: Building, wall: int, kit: Kit, pages: Pages, texel: float) -> Part:
    """One wall with all that is on it, in its own frame."""
    rng = stream(building.looks, "wall things", 0 if building.repeated else wall)
    openings, line = openings_of(building, wall), profile(building, wall)
    length, top = float(wall_lengths(building)[wall]), float(line[:, 1].max())
    page = pages.add(*painted_wall(building, wall, openings, top, texel))
    face = Face(length, page, top, building.walls_m + parapet_m(building))
    things = [
        wall_face(face, openings, line),
        windows(kit, rng, openings, 0.0 if building.water_up is None else BROKEN_SHARE),
        infills(kit, openings),
        doors(kit, rng, openings),
        bands(kit, face, openings, _courses(building), 0.0 if is_hall(building) else 0.3),
    ]
    if not building.repeated:
        free = room_on(building, length, openings)
        things.append(fittings(building, kit, pages, rng, free, role(building, wall), hall=is_hall(building)))
    return join(things)


def _courses(building: Building) -> list[float]:
    """Heights of bands of stone: some buildings have them at each floor, some only over the ground floor."""
    if is_hall(building):
        return []
    kind = stream(building.looks, "courses").random()
    floors = [k * building.storey_m - 0.2 for k in range(1, building.storeys)]
    return floors if kind < 0.25 else floors[:1] if kind < 0.5 else []


def _placed(part: Part, building: Building) -> Part:
    return part.placed(building.heading_deg, (building.east, building.north, building.up))
