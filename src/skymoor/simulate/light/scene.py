# SPDX-License-Identifier: Apache-2.0
"""Triangles under a sun: what a ray meets, and what light comes back along it.

One bounce of light: the sun with shadows, the sky as far as it is seen from a place, a little light from the ground;
glass and water mirror one more ray (Fresnel by Schlick 1994). Colours are linear; a white wall that faces the sun is
about 1.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skymoor.engines.raycast import RayCaster
from skymoor.simulate.light.pages import Pages
from skymoor.simulate.light.sky import BOUNCE, HORIZON, SKYLIGHT, SUNLIGHT, Openness, measure_openness, sky_colours
from skymoor.simulate.mesh import Label, Part, join

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

CHUNK = 1 << 16  # rays at a time: their arrays stay in the cache
FINE_M = 0.04  # finer than this the pages have nothing, and the fine grain takes over
GLASS_REFLECTANCE, COATED_REFLECTANCE, WATER_REFLECTANCE = 0.08, 0.35, 0.03


@dataclass(frozen=True, eq=False)
class Hits:
    """Per ray: distance in units of its direction (infinite: sky), label, triangle (-1: sky), place on it, normal."""

    distance: Array32
    label: NDArray[np.uint8]
    triangle: NDArray[np.int32]
    place: Array32  # (n, 2) barycentric
    normal: Array32  # (n, 3) unit, towards the ray's origin


@dataclass(frozen=True, eq=False)
class Scene:
    """A site on one day.

    Attributes:
        solid, leafy: triangles; leaves let some light through and do not count against the sky.
        pages: their textures; `grain` is the page of fine grain that near surfaces show on top of their own.
        sun: unit vector (3,) towards the sun.
        clouds: (h, w) periodic cover in [0, 1].
        haze_per_m: share of light lost to the air per metre.
        ripples: (h, w, 2) periodic slopes of water, in 0.1 m cells.
        lattice: radius, lowest and highest level in metres of the part whose openness to the sky is measured.
    """

    solid: Part
    leafy: Part
    pages: Pages
    grain: int
    sun: Array
    clouds: Array32
    haze_per_m: float
    ripples: Array32
    lattice: tuple[float, float, float]

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """What rays (n, 3) from origins (3,) or (n, 3) meet first."""
        d = np.asarray(directions, dtype=np.float32).reshape(-1, 3)
        distance, triangle, place, normal = self._caster.hits(np.asarray(origins, np.float32), d)
        hit = triangle >= 0
        facing = np.where(np.einsum("ij,ij->i", normal, d) > 0, np.float32(-1), np.float32(1))
        label = np.where(hit, self._all.label[np.maximum(triangle, 0)], np.uint8(Label.SKY))
        return Hits(distance, label.astype(np.uint8), triangle, place, normal * facing[:, None])

    def radiance(
        self, origins: ArrayLike, directions: ArrayLike, *, pixel_m: float = 0.0, pixel_rad: float = 0.0
    ) -> Array32:
        """Light (n, 3) back along rays (n, 3); a ray is `pixel_m + pixel_rad * distance` wide."""
        d = np.asarray(directions, dtype=np.float32).reshape(-1, 3)
        o = np.broadcast_to(np.asarray(origins, np.float32), d.shape)
        light = np.empty_like(d)

        def shade(first: int) -> None:
            part = slice(first, first + CHUNK)
            light[part] = self._shade(o[part], d[part], pixel_m, pixel_rad, mirrors=True)

        self._in_threads(shade, range(0, len(d), CHUNK))
        return light

    def _shade(
        self, origins: Array32, directions: Array32, pixel_m: float, pixel_rad: float, *, mirrors: bool
    ) -> Array32:
        d: Array32 = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        hits = self.cast(origins, d)
        light: Array32 = np.empty_like(d)
        sky = hits.triangle < 0
        light[sky] = sky_colours(d[sky], self.sun, self.clouds)
        index = np.flatnonzero(~sky)
        if not len(index):
            return light
        here = Hits(*(getattr(hits, name)[index] for name in ("distance", "label", "triangle", "place", "normal")))
        points = origins[index] + here.distance[:, None] * d[index]
        footprint = pixel_m + pixel_rad * here.distance
        colour = self._albedo(here, footprint) * self._irradiance(points, here)
        if mirrors:
            self._mirror(colour, points, d[index], here, footprint)
        seen = np.exp(-self.haze_per_m * here.distance)[:, None]
        light[index] = colour * seen + HORIZON * 0.9 * (1 - seen)
        return light

    def _albedo(self, hits: Hits, footprint: Array32) -> Array32:
        triangle = hits.triangle
        b, c = hits.place[:, :1], hits.place[:, 1:]
        corners = self._all.uv[triangle]
        uv = corners[:, 0] * (1 - b - c) + corners[:, 1] * b + corners[:, 2] * c
        page = self._all.page[triangle]
        albedo = self.pages.colours(page, uv, footprint) * self._all.tint[triangle]
        near = np.flatnonzero((footprint < FINE_M) & (hits.label != Label.GLASS) & (hits.label != Label.WATER))
        if len(near):
            # Turned, and moved from page to page, so that its repeats fall elsewhere on every surface.
            shift = page[near, None] * np.array([0.37, 0.61], np.float32)
            turned = uv[near] @ np.array([[0.8, 0.6], [-0.6, 0.8]], np.float32) + shift
            grain = self.pages.colours(np.full(len(near), self.grain), turned, footprint[near])
            lawn = (hits.label[near] == Label.GROUND) & (albedo[near, 1] > 1.35 * albedo[near, 2])
            albedo[near] *= np.where(lawn, grain[:, 1], grain[:, 0])[:, None] * 2
        return albedo

    def _irradiance(self, points: Array32, hits: Hits) -> Array32:
        normal = hits.normal
        slope = normal @ self.sun.astype(np.float32)
        leaf = hits.label == Label.PLANT
        slope = np.where(leaf, 0.35 + 0.4 * np.abs(slope), np.maximum(slope, 0))
        lit = np.flatnonzero(slope > 0)
        start = points[lit] + np.float32(0.02) * normal[lit]
        slope[lit] *= ~self._caster.occluded(start, self.sun.astype(np.float32))
        upward = 0.5 + 0.5 * normal[:, 2]
        open_sky = self._openness.at(points, normal)
        direct = slope[:, None] * SUNLIGHT
        sky = (open_sky * (0.25 + 0.75 * upward))[:, None] * SKYLIGHT
        bounce = ((1 - upward) * (0.3 + 0.7 * open_sky) + 0.1)[:, None] * BOUNCE
        return np.asarray(direct + sky + bounce, dtype=np.float32)

    def _mirror(self, colour: Array32, points: Array32, d: Array32, hits: Hits, footprint: Array32) -> None:
        """Add what glass and water reflect, in place."""
        shiny = np.flatnonzero((hits.label == Label.GLASS) | (hits.label == Label.WATER))
        if not len(shiny):
            return
        normal = hits.normal[shiny].copy()
        wet = hits.label[shiny] == Label.WATER
        cell = np.mod((points[shiny, :2] * 10).astype(np.int32), self.ripples.shape[0])
        slopes = self.ripples[cell[:, 1], cell[:, 0]]
        # Panes are not quite flat either, and not quite parallel.
        normal[:, :2] += np.where(wet[:, None], slopes, 0.06 * slopes)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        cosine = np.clip(-np.einsum("ij,ij->i", d[shiny], normal), 0.02, 1)
        coated = np.isin(self._all.page[hits.triangle[shiny]], list(self.pages.coated))
        glass = np.where(coated, COATED_REFLECTANCE, GLASS_REFLECTANCE)
        base = np.where(wet, WATER_REFLECTANCE, glass).astype(np.float32)
        share = (base + (1 - base) * (1 - cosine) ** 5)[:, None]
        away = d[shiny] + 2 * cosine[:, None] * normal
        away[:, 2] = np.where(wet, np.maximum(away[:, 2], 0.02), away[:, 2])
        start = points[shiny] + np.float32(0.02) * hits.normal[shiny]
        mirrored = self._shade(start, away, float(np.median(footprint[shiny])), 0.004, mirrors=False)
        colour[shiny] = colour[shiny] * (1 - share) + mirrored * share

    def _in_threads(self, work: Callable[[int], None], items: range) -> None:
        _ = self._openness  # made once, before the threads ask for it
        if len(items) < 2:
            for item in items:
                work(item)
            return
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            list(pool.map(work, items))

    @cached_property
    def _all(self) -> Part:
        return join([self.solid, self.leafy])

    @cached_property
    def _caster(self) -> RayCaster:
        return _caster(self._all.corners)

    @cached_property
    def _openness(self) -> Openness:
        radius, low, high = self.lattice
        solid = _caster(self.solid.corners)
        return measure_openness(partial(solid.occluded, reach=1.0), radius, low, high)


def _caster(corners: Array32) -> RayCaster:
    """Triangles (n, 3, 3) ready for rays; threads are started over chunks of rays, not inside of a chunk."""
    return RayCaster(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), threads=1)
