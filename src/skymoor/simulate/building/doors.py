# SPDX-License-Identifier: Apache-2.0
"""Doors, gates, docks and balconies, in the wall's own frame (see `openings`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from skymoor.simulate.building.kit import Kit, Palette
from skymoor.simulate.building.materials import Rng
from skymoor.simulate.building.openings import Opening
from skymoor.simulate.building.solids import bars, boxes, on_wall
from skymoor.simulate.mesh import Array, Label, Part, cylinder, join, parallelograms

_STEP_M = 0.16
_BLACK = (0.03, 0.03, 0.03)


def doors(kit: Kit, rng: Rng, openings: Iterable[Opening]) -> Part:
    """Everything that belongs to doors and gates, but for the leaves of gates: those move from day to day."""
    makers: dict[str, Callable[[Kit, Rng, Opening], Part]] = {
        "steel": _steel_door,
        "glazed": _entrance,
        "roller": _gate,
        "dock": _dock,
        "balcony": _balcony,
    }
    return join(makers[opening.kind](kit, rng, opening) for opening in openings if opening.kind in makers)


def gate_leaf(colours: Palette, grain: int, opening: Opening, open_share: float) -> Part:
    """The leaf of a gate, rolled up by `open_share` of its height: narrow slats one over the other."""
    depth = 0.16 if opening.kind == "roller" else 0.3
    foot = opening.z0 + open_share * (opening.z1 - opening.z0)
    slats = np.arange(opening.z1, foot, -0.12)
    tints = colours.gate * (0.93 + 0.05 * np.cos(np.arange(len(slats)) * 2.4))[:, None]
    rect = np.column_stack(
        [
            np.full(len(slats), opening.x0),
            np.maximum(slats - 0.12, foot),
            np.full(len(slats), opening.x1),
            np.maximum(slats - 0.012, foot + 0.001),
        ]
    )
    back = parallelograms(
        [[opening.x0, depth + 0.02, foot]],
        [[opening.x1 - opening.x0, 0, 0]],
        [[0, 0, opening.z1 - foot]],
        grain,
        Label.WALL,
        0.5 * colours.gate,
    )
    return join([on_wall(rect, -depth, grain, Label.WALL, tints, in_m=depth + 0.02), back])


def _steel_door(kit: Kit, rng: Rng, door: Opening) -> Part:
    """A leaf in a frame, with a handle, sometimes a grille, a lamp above, and steps."""
    x0, z0, x1, z1 = door.rect
    r = door.recess_m
    leaf = on_wall([[x0 + 0.05, z0, x1 - 0.05, z1 - 0.05]], -(r - 0.05), kit.grain, Label.WALL, kit.door, in_m=r)
    frame = [[x0, z0, x0 + 0.05, z1], [x1 - 0.05, z0, x1, z1], [x0, z1 - 0.05, x1, z1]]
    parts = [leaf, on_wall(frame, -(r - 0.08), kit.grain, Label.OBJECT, 0.7 * kit.door, in_m=r)]
    parts.append(on_wall([[x1 - 0.17, 1.0, x1 - 0.07, 1.05]], -(r - 0.12), kit.grain, Label.OBJECT, kit.metal, in_m=r))
    kick = [[x0 + 0.1, z0 + 0.03, x1 - 0.1, z0 + 0.28], [x0 + 0.05, z0 + 1.0, x1 - 0.05, z0 + 1.02]]
    parts.append(on_wall(kick, -(r - 0.056), kit.grain, Label.OBJECT, 0.75 * kit.door, in_m=r))
    if rng.random() < 0.5:
        z = z0 + np.arange(0.25, 0.65, 0.08)
        bar = np.column_stack([0 * z + x0 + 0.2, z, 0 * z + x1 - 0.2, z + 0.03])
        parts.append(on_wall(bar, -(r - 0.065), kit.grain, Label.OBJECT, 0.4 * kit.door, in_m=r))
    lamp = on_wall([[x0 + 0.35, z1 + 0.25, x0 + 0.6, z1 + 0.37]], 0.16, kit.grain, Label.OBJECT, (0.5, 0.5, 0.47))
    if rng.random() < 0.4:
        parts.append(_canopy(kit, door, 0.8))
    return join([*parts, lamp, _steps(kit, door, 1)])


def _entrance(kit: Kit, rng: Rng, door: Opening) -> Part:
    """What surrounds a glazed door: bottom rails, handles, canopy, steps with rails."""
    x0, z0, x1, _ = door.rect
    r, middle = door.recess_m, (door.x0 + door.x1) / 2
    rail = on_wall([[x0, z0, x1, z0 + 0.22]], -(r - 0.05), kit.grain, Label.OBJECT, door.style.tint, in_m=r)
    grips = [[middle - 0.12, 0.85, middle - 0.09, 1.35], [middle + 0.09, 0.85, middle + 0.12, 1.35]]
    parts = [rail, on_wall(grips, -(r - 0.1), kit.grain, Label.OBJECT, (0.45, 0.45, 0.45), in_m=r)]
    if rng.random() < 0.5:
        posts = [[[x, -1.7, -2.5], [x, -1.7, 0.95]] for x in (x0 - 0.5, x1 + 0.5)]
        posts += [[[x, -0.05, 0.95], [x, -1.7, 0.95]] for x in (x0 - 0.5, x1 + 0.5)]
        ends = np.array(posts)
        parts.append(bars(ends[:, 0], ends[:, 1], 0.045, kit.grain, Label.OBJECT, kit.metal))
    return join([*parts, _canopy(kit, door, float(rng.uniform(0.9, 1.5))), _steps(kit, door, 3)])


def _canopy(kit: Kit, door: Opening, out_m: float) -> Part:
    slab = [[door.x0 - 0.4, door.z1 + 0.42, door.x1 + 0.4, door.z1 + 0.56]]
    rods = np.array(
        [[[x, -0.9 * out_m, door.z1 + 0.5], [x, 0.0, door.z1 + 1.2]] for x in (door.x0 - 0.2, door.x1 + 0.2)]
    )
    return join(
        [
            on_wall(slab, out_m, kit.grain, Label.OBJECT, kit.metal),
            bars(rods[:, 0], rods[:, 1], 0.03, kit.grain, Label.OBJECT, kit.metal),
        ]
    )


def _steps(kit: Kit, door: Opening, count: int) -> Part:
    """A landing and steps that go on under the ground: how many show depends on the slope."""
    k = np.arange(count + 4)
    out = 0.9 + 0.3 * k
    low = np.column_stack([door.x0 - 0.3 + 0 * out, -out, np.full(len(k), -2.5)])
    high = np.column_stack([door.x1 + 0.3 + 0 * out, 0 * out, -0.02 - _STEP_M * k])
    tints = kit.stone * (0.85 - 0.04 * (k % 2))[:, None]
    return boxes(low, high, kit.grain, Label.OBJECT, tints, faces=("-y", "+x", "-x", "+z"))


def _gate(kit: Kit, rng: Rng, gate: Opening) -> Part:
    """Rails at both sides, the box of the roll, posts that keep lorries off, and the dark hall behind."""
    x0, z0, x1, z1 = gate.rect
    rails = [[x0 - 0.12, z0, x0, z1], [x1, z0, x1 + 0.12, z1], [x0 - 0.12, z1, x1 + 0.12, z1 + 0.3]]
    parts = [on_wall(rails, 0.09, kit.grain, Label.OBJECT, 0.6 * kit.gate), _dark(kit, rng, gate)]
    yellow = np.array([0.45, 0.33, 0.04]) * rng.uniform(0.5, 1.0)
    posts = (
        cylinder((x, -0.5, -2.5), 0.08, 3.5, kit.grain, Label.OBJECT, yellow, facets=8, cap=Label.OBJECT)
        for x in (x0 - 0.35, x1 + 0.35)
    )
    apron = boxes([[x0 - 0.6, -1.6, -2.5]], [[x1 + 0.6, 0, -0.02]], kit.grain, Label.PAVED, 0.8 * kit.stone)
    return join([*parts, *posts, apron])


def _dock(kit: Kit, rng: Rng, dock: Opening) -> Part:
    """A gate at the height of a lorry's floor, in a black seal, with rubber bumpers and a levelling plate."""
    x0, z0, x1, z1 = dock.rect
    seal = [[x0 - 0.35, z0 - 0.1, x0, z1], [x1, z0 - 0.1, x1 + 0.35, z1], [x0 - 0.35, z1, x1 + 0.35, z1 + 0.5]]
    bumpers = [[x0 + 0.1, z0 - 0.55, x0 + 0.35, z0 - 0.1], [x1 - 0.35, z0 - 0.55, x1 - 0.1, z0 - 0.1]]
    plate = [[x0, z0 - 0.08, x1, z0]]
    return join(
        [
            on_wall(seal, 0.35, kit.grain, Label.OBJECT, rng.uniform(0.03, 0.07) * np.ones(3)),
            on_wall(bumpers, 0.22, kit.grain, Label.OBJECT, _BLACK),
            on_wall(plate, 0.12, kit.grain, Label.OBJECT, (0.20, 0.19, 0.17)),
            _dark(kit, rng, dock),
        ]
    )


def _dark(kit: Kit, rng: Rng, opening: Opening) -> Part:
    """The dim inside of a hall, at the end of the opening's reveal."""
    uv = kit.rooms.uv(rng, [opening.rect])
    x0, z0, x1, z1 = opening.rect
    back = parallelograms(
        [[x0, opening.recess_m, z0]], [[x1 - x0, 0, 0]], [[0, 0, z1 - z0]], kit.rooms.page, Label.WALL, (0.4, 0.4, 0.4)
    )
    texture = uv[:, [0, 1, 2, 0, 2, 3]].reshape(2, 3, 2).astype(np.float32)
    return Part(back.corners, texture, back.page, back.label, back.tint)


def _balcony(kit: Kit, rng: Rng, door: Opening) -> Part:
    """A slab with a railing of bars or of boards."""
    x0, x1, z = door.x0 - 0.8, door.x1 + 0.8, door.z0 - 0.04
    out = 1.25
    low, high = [[x0, -out, z - 0.18]], [[x1, 0, z]]
    slab = boxes(low, high, kit.grain, Label.WALL, kit.stone, faces=("-y", "+x", "-x", "+z", "-z"))
    rail = np.array([[[x0, -0.03, z + 1.0], [x0, -out, z + 1.0]], [[x0, -out, z + 1.0], [x1, -out, z + 1.0]]])
    rail = np.concatenate([rail, [[[x1, -out, z + 1.0], [x1, -0.03, z + 1.0]]]])
    foot = _balusters(x0, x1, out, z)
    tint = kit.metal * rng.uniform(0.8, 1.1)
    return join(
        [
            slab,
            bars(rail[:, 0], rail[:, 1], 0.05, kit.grain, Label.OBJECT, tint),
            bars(foot, foot + [0, 0, 0.95], 0.022, kit.grain, Label.OBJECT, tint),
        ]
    )


def _balusters(x0: float, x1: float, out: float, z: float) -> Array:
    """Feet (n, 3) of the bars on three sides of a slab."""
    along, across = np.arange(x0, x1 + 0.01, 0.16), np.arange(0.08, out, 0.16)
    front = np.column_stack([along, np.full_like(along, -out), np.full_like(along, z)])
    sides = [np.column_stack([np.full_like(across, x), -across, np.full_like(across, z)]) for x in (x0, x1)]
    return np.concatenate([front, *sides])
