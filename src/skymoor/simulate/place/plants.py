# SPDX-License-Identifier: Apache-2.0
"""Trees and hedges: clouds of leaves around branches."""

from __future__ import annotations

import numpy as np

from skymoor.simulate.mesh import Label, Part, join, quads, stream, triangles
from skymoor.simulate.place.land import Land
from skymoor.simulate.plan import Array, Season

LEAF = {
    "summer": ((0.07, 0.13, 0.03), (0.13, 0.19, 0.06), (0.09, 0.15, 0.07)),
    "autumn": ((0.28, 0.17, 0.04), (0.24, 0.10, 0.04), (0.14, 0.15, 0.05)),
    "winter": ((0.10, 0.09, 0.06), (0.05, 0.08, 0.04), (0.11, 0.10, 0.07)),
}
BARK = (0.12, 0.10, 0.08)
EVERGREEN = 0.25  # share of the trees
NEAR_LEAVES, FAR_LEAVES = 6500, 260
TALL_HEDGE_M = 2.1
SMALL_CROWN_M, FINE_TWIG_M, FINE_LEAVES = 2.3, 0.13, 8500
LARGE_CROWN_M = 4.5  # radius, from which on twigs are larger, not more, for the triangles that they cost


def trees(
    plan: Array, land: Land, radius_m: float, season: Season, seed: int, *, fine: bool = False
) -> tuple[Part, Part]:
    """Trunks and crowns of trees (n, 4): east, north, height, crown radius. Those beyond `radius_m` are plainer.

    With `fine`, near small crowns have twigs that can be looked at from close by.
    """
    trunks, crowns = [], []
    base = land.height(plan[:, 0], plan[:, 1])
    for k, ((east, north, height, crown), up) in enumerate(zip(plan, base, strict=True)):
        rng = stream(seed, "tree", k)
        near = max(abs(east), abs(north)) < radius_m + 15
        foot = np.array([east, north, up - 0.2])
        evergreen = rng.uniform() < EVERGREEN
        trunk, blobs = _branches(foot, height, crown, rng, conifer=evergreen)
        trunks.append(trunk)
        bare = season == "winter" and not evergreen
        count = (NEAR_LEAVES if near else FAR_LEAVES) // (6 if bare else 1)
        tones = LEAF["summer" if evergreen else season]
        size_m = _twig_m(crown, near=near, bare=bare)
        if fine and near and crown < SMALL_CROWN_M:
            size_m, count = FINE_TWIG_M, FINE_LEAVES // (6 if bare else 1)
        crowns.append(_leaves(blobs, count, np.array(tones[rng.integers(3)]), rng, size_m=size_m))
    return join(trunks), join(crowns)


def hedge(
    middle: Array, heading_deg: float, land: Land, season: Season, rng: np.random.Generator, *, tall: bool = False
) -> Part:
    """Clipped shrubs, five metres long."""
    count, height = (2800, TALL_HEDGE_M) if tall else (1500, 1.3)
    inside = rng.uniform(-0.5, 0.5, (count, 3)) * [5.0, 1.1, height] + [0, 0, height / 2 - 0.1]
    tone = np.array(LEAF["summer" if season == "summer" else "winter"][1])
    part = _cards(inside, 0.17, tone, rng)
    return part.placed(heading_deg, [*middle, float(land.height(*middle))])


def _twig_m(crown: float, *, near: bool, bare: bool) -> float:
    """Size of the triangles of a crown of that radius."""
    if crown <= LARGE_CROWN_M:
        return 0.22 if near else 0.9
    return crown * (0.07 if near else 0.25) * (0.6 if bare else 1.0)


def _branches(
    foot: Array, height: float, crown: float, rng: np.random.Generator, *, conifer: bool
) -> tuple[Part, Array]:
    """Trunk and main branches, and the blobs (n, 6: centre, radii) that leaves gather in."""
    top = foot + [0, 0, height * (0.95 if conifer else 0.55)]
    ends = [(foot, top, 0.028 * height, 0.012 * height)]
    if conifer:
        level = np.linspace(0.18, 0.98, 9)
        wide = crown * 0.75 * (1.05 - level)
        blobs = np.column_stack(
            [np.tile(foot[:2], (9, 1)) + rng.normal(scale=0.08, size=(9, 2)), foot[2] + level * height]
            + [wide, wide, np.full(9, 0.09 * height)]
        )
        return _poles(ends), blobs
    count = 11
    turn, out = rng.uniform(0, 2 * np.pi, count), crown * np.sqrt(rng.uniform(0, 0.75, count))
    up = foot[2] + height * rng.uniform(0.45, 0.86, count)
    centres = np.column_stack([foot[0] + out * np.cos(turn), foot[1] + out * np.sin(turn), up])
    start = foot + [0, 0, height * 0.33]
    ends += [(start, centre, 0.013 * height, 0.004 * height) for centre in centres]
    radii = crown * rng.uniform(0.42, 0.62, (count, 1)) * [1, 1, 0.8]
    return _poles(ends), np.column_stack([centres, radii])


def _poles(ends: list[tuple[Array, Array, float, float]]) -> Part:
    """Five-sided poles between pairs of points."""
    faces = []
    turn = np.linspace(0, 2 * np.pi, 6)
    for foot, head, thick, thin in ends:
        axis = (head - foot) / np.linalg.norm(head - foot)
        side = np.cross(axis, [0.31, 0.95, 0.1])
        side /= np.linalg.norm(side)
        ring = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)
        low, high = foot + thick * ring, head + thin * ring
        faces.append(np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1))
    corners = np.concatenate(faces)
    return quads(corners, corners[..., :2], 0, Label.OBJECT, BARK)


def _leaves(blobs: Array, count: int, tone: Array, rng: np.random.Generator, *, size_m: float) -> Part:
    weight = blobs[:, 3] ** 2
    which = rng.choice(len(blobs), count, p=weight / weight.sum())
    away = rng.normal(size=(count, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    middle = blobs[which, :3] + away * blobs[which, 3:] * rng.uniform(0.55, 1.0, (count, 1))
    return _cards(middle, size_m, tone, rng)


def _cards(middle: Array, size_m: float, tone: Array, rng: np.random.Generator) -> Part:
    """Leafy twigs as random triangles; each has its own shade."""
    n = len(middle)
    corners = middle[:, None] + rng.normal(scale=0.55 * size_m, size=(n, 3, 3))
    shade = rng.lognormal(sigma=0.28, size=(n, 1)) * (1 + 0.10 * rng.normal(size=(n, 3)))
    return triangles(corners, np.zeros((n, 3, 2)), 0, Label.PLANT, np.clip(tone * shade, 0.01, 0.6))
