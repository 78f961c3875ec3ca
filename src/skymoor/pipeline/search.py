# SPDX-License-Identifier: Apache-2.0
"""Search of the nadir render in the reference, at the azimuths and flying heights in question."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skymoor.match.features import Features
from skymoor.match.hypothesis import ImageHypothesis
from skymoor.match.propose import ALL_AZIMUTHS
from skymoor.match.rasters import nadir_raster, reference_raster
from skymoor.match.search import SearchOptions, refine_in, search_hypotheses
from skymoor.reference.read import read_part
from skymoor.types import Array, Progress, Reference, Render, View, no_progress

MapFiles = tuple[Path, Path | float | None, str | None]
"""Orthophoto, DSM and vertical datum, as `read_reference` takes them."""
WIDER = 1.2  # times the render's diagonal: side of the part
MARGIN_PX = 40  # of the searched reference, around it: a place found there is right to a few of them


@dataclass(frozen=True)
class Extent:
    """What is searched: the least and the largest metres per unit of the level frame, which is the flying height, and
    the azimuths of that frame, by their middle and half width in radians.
    """

    heights_m: tuple[float, float]
    azimuths: tuple[float, float] = ALL_AZIMUTHS

    def scales(self, render: Render, reference: Reference) -> tuple[float, float]:
        """Pixels of the reference per pixel of the render, for the flying heights."""
        px_per_metre = render.view.pixel / reference.grid.pixel_m
        return self.heights_m[0] * px_per_metre, self.heights_m[1] * px_per_metre


@dataclass(frozen=True, eq=False)
class Place:
    """A hypothesis, and the part of the reference whose pixels it is given in."""

    hypothesis: ImageHypothesis
    reference: Reference


def search_reference(
    render: Render,
    reference: Reference,
    features: Features,
    extent: Extent,
    min_confidence: float,
    options: SearchOptions,
    *,
    progress: Progress = no_progress,
) -> list[ImageHypothesis]:
    """Hypotheses of position, azimuth and scale, best first; empty where the reference is too small at every height.

    `features` are those of the reference.
    """
    low, high = extent.scales(render, reference)
    return search_hypotheses(
        nadir_raster(render, min_confidence),
        reference_raster(reference),
        min_scale=low,
        max_scale=high,
        options=options,
        azimuths=extent.azimuths,
        features=features,
        progress=progress,
    )


def places_of(
    hypotheses: Sequence[ImageHypothesis],
    render: Render,
    whole: Reference,
    files: MapFiles,
    min_confidence: float,
    options: SearchOptions,
) -> list[Place]:
    """The places of hypotheses, each with the part of the reference around it: what follows need not know the rest.

    Where the reference had to be searched coarser than its orthophoto, the part is read again in all detail and the
    hypothesis refined in it. `files` are those that the reference was read from. Scores remain those of the search,
    which compared them with each other and with those of decoys.
    """
    image, found = nadir_raster(render, min_confidence), []
    for one in hypotheses:
        middle = whole.grid.enu_from_px(np.array([one.centre_px]))[0]
        half = whole.grid.pixel_m * (0.5 * WIDER * one.scale * float(np.hypot(*image.mask.shape)) + MARGIN_PX)
        bounds = [*(middle - half), *(middle + half)]
        part = whole.part(bounds)
        place = Place(_moved(one, middle, whole, part), part)
        if whole.detail_lost:
            inside = [*np.maximum(bounds[:2], whole.grid.bounds[:2]), *np.minimum(bounds[2:], whole.grid.bounds[2:])]
            grid, rgb, mask, height = read_part(*files, whole.frame, inside, whole.finest_m)
            finer = replace(whole, grid=grid, rgb=rgb, mask=mask, height=height, notes=())
            refined = refine_in(reference_raster(finer), image, [_moved(one, middle, whole, finer)], options)
            if refined:
                best = replace(refined[0], score=one.score, by_features=one.by_features)
                place = Place(best, finer)
        found.append(place)
    return found


def _moved(one: ImageHypothesis, middle: Array, whole: Reference, part: Reference) -> ImageHypothesis:
    """A hypothesis at the position `middle` (2,) in metres, in pixels of a part."""
    u, v = part.grid.px_from_enu(middle).tolist()
    ratio = whole.grid.pixel_m / part.grid.pixel_m
    return ImageHypothesis(one.scale * ratio, one.azimuth_rad, (u, v), one.score, one.by_features)


def search_again(
    found: Sequence[ImageHypothesis],
    before: tuple[Render, Array],
    now: tuple[Render, Array],
    reference: Reference,
    min_confidence: float,
    options: SearchOptions,
) -> list[ImageHypothesis]:
    """Hypotheses of a component that was found before with another focal length: refined from the same places.

    `before` and `now` are its renders and the centres (n, 2) of the same cameras in plan, in the level frame of each.
    """
    (first, centres), (render, moved) = before, now
    turned = _similarity(moved, centres)
    start = []
    for one in found:
        b_from_a = _square(one.matrix(first.view.shape)) @ _px_from_level(first.view) @ turned
        b_from_a = b_from_a @ np.linalg.inv(_px_from_level(render.view))
        u, v, _ = b_from_a @ [render.view.shape[1] / 2, render.view.shape[0] / 2, 1.0]
        scale, azimuth = np.hypot(b_from_a[0, 0], b_from_a[1, 0]), np.arctan2(b_from_a[1, 0], b_from_a[0, 0])
        start.append(replace(one, scale=float(scale), azimuth_rad=float(azimuth), centre_px=(float(u), float(v))))
    return refine_in(reference_raster(reference), nadir_raster(render, min_confidence), start, options)


def _similarity(a: Array, b: Array) -> Array:
    """(3, 3) of the similarity in plan that lays points a (n, 2) on b by least squares."""
    x, y = (points[:, 0] + 1j * points[:, 1] for points in (a, b))
    factor, shift = np.linalg.lstsq(np.column_stack([x, np.ones_like(x)]), y, rcond=None)[0]
    return np.array([[factor.real, -factor.imag, shift.real], [factor.imag, factor.real, shift.imag], [0, 0, 1]])


def _px_from_level(view: View) -> Array:
    """(3, 3) from plan positions of the level frame to pixels of a view straight down."""
    affine = _square(np.column_stack([view.view_from_level[:2, :2], [-view.x0, -view.y0]]))
    affine[:2] /= view.pixel
    return affine


def _square(affine: Array) -> Array:
    return np.vstack([affine, [0.0, 0.0, 1.0]])
