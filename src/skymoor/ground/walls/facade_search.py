# SPDX-License-Identifier: Apache-2.0
"""Where a facade's picture lies in others, at which scale: both are upright, so no heading is searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skymoor.match.channels import ChannelOptions, make_channels
from skymoor.match.correlate import Target, correlate, peaks
from skymoor.match.pyramid import Pyramid
from skymoor.types import Array, Progress, Raster, no_progress

FEWEST_PX = 300
SHORTEST_PX = 12


@dataclass(frozen=True)
class FacadeSearchOptions:
    """Size of the search over scale and shift.

    Attributes:
        scale_step: spacing of the scales.
        min_overlap: share of the picture that must lie on the other one.
        per_pair: places that are kept of each pair of pictures at each scale.
        apart_px: distance between those.
        sharp, blurred: channels of the searched pictures, taken from near, and of the others, taken from far: the
            former are smoothed more, to look alike.
    """

    scale_step: float = 1.04
    min_overlap: float = 0.3
    per_pair: int = 3
    apart_px: int = 8
    sharp: ChannelOptions = field(default_factory=lambda: ChannelOptions(smooth_px=1.3))
    blurred: ChannelOptions = field(default_factory=ChannelOptions)


@dataclass(frozen=True)
class FacadeHypothesis:
    """Picture `a` lies on picture `b`: pixel p of a at `scale * p + place` of b; `score` as of `correlate`."""

    a: int
    b: int
    scale: float
    place: tuple[float, float]
    score: float

    @property
    def matrix(self) -> Array:
        """(2, 3) affine, pixels of b from pixels of a."""
        return np.array([[self.scale, 0.0, self.place[0]], [0.0, self.scale, self.place[1]]])


def search_facades(
    pictures: Sequence[Raster],
    others: Sequence[Raster],
    *,
    min_scale: float,
    max_scale: float,
    options: FacadeSearchOptions | None = None,
    progress: Progress = no_progress,
) -> list[FacadeHypothesis]:
    """Places of each picture in each of the others, best first; scale is pixels of the other per pixel of the picture.

    Pictures that are too small at a scale, and others that show next to nothing, are passed over.
    """
    options = options or FacadeSearchOptions()
    targets = {
        b: Target(make_channels(other, options.blurred))
        for b, other in enumerate(others)
        if other.mask.sum() >= FEWEST_PX
    }
    steps = max(round(float(np.log(max_scale / min_scale) / np.log(options.scale_step))), 0)
    scales = min_scale * options.scale_step ** np.arange(steps + 1)
    found: list[FacadeHypothesis] = []
    for a, picture in enumerate(pictures):
        pyramid = Pyramid(picture)
        for scale in scales:
            found += _at_scale(a, pyramid, float(scale), targets, options)
        progress(a + 1, len(pictures))
    return sorted(found, key=lambda shift: -shift.score)


def _at_scale(
    a: int, pyramid: Pyramid, scale: float, targets: dict[int, Target], options: FacadeSearchOptions
) -> list[FacadeHypothesis]:
    small = pyramid.at(scale)
    if min(small.mask.shape) < SHORTEST_PX or small.mask.sum() < FEWEST_PX:
        return []
    template = make_channels(small, options.sharp)
    height, width = small.mask.shape
    area = float(template.known[0].sum())
    found: list[FacadeHypothesis] = []
    for b, target in targets.items():
        if target.channels.known[0].sum() < options.min_overlap * area:
            continue
        scores = correlate(template, target, min_overlap=options.min_overlap)
        for v, u, score in peaks(scores, count=options.per_pair, apart=options.apart_px):
            found.append(FacadeHypothesis(a, b, scale, (u - width + 1, v - height + 1), score))
    return found


@dataclass(frozen=True)
class Drift:
    """How well two pictures agree where they lie, `here`, and at the best place within reach, `there`, `px` away.

    Scores are as of `correlate`; `px` is (u, v) by which the first picture must move.
    """

    here: float
    there: float
    px: tuple[float, float]


def drift(
    near: Raster, far: Raster, *, reach_px: int, still_px: int, options: FacadeSearchOptions | None = None
) -> Drift | None:
    """Whether a picture from near lies well on one from far, of the same size; None where they share too little.

    Moves up to `still_px` count as `here`; `reach_px` is the largest that is tried.
    """
    options = options or FacadeSearchOptions()
    if min(near.mask.sum(), far.mask.sum()) < FEWEST_PX:
        return None
    template = make_channels(near, options.sharp)
    scores = correlate(template, Target(make_channels(far, options.blurred)), min_overlap=options.min_overlap)
    v0, u0 = near.mask.shape[0] - 1, near.mask.shape[1] - 1
    top, left = max(v0 - reach_px, 0), max(u0 - reach_px, 0)
    window = scores[top : v0 + reach_px + 1, left : u0 + reach_px + 1]
    still = scores[max(v0 - still_px, 0) : v0 + still_px + 1, max(u0 - still_px, 0) : u0 + still_px + 1]
    for v, u, there in peaks(window, count=1, apart=1):
        return Drift(max(float(still.max()), 0.0), there, (u + left - u0, v + top - v0))
    return None


def agreement(
    pairs: Sequence[tuple[Raster, Raster]], options: FacadeSearchOptions | None = None
) -> tuple[float, float]:
    """NCC of pictures laid on each other, pooled over all pairs, and the score: NCC times the root of the pixels.

    The first of each pair is the one taken from near, resampled to the pixels of the second.
    """
    options = options or FacadeSearchOptions()
    product = energy_a = energy_b = pixels = 0.0
    for near, far in pairs:
        a, b = make_channels(near, options.sharp), make_channels(far, options.blurred)
        both = a.known[0] * b.known[0]
        product += float((a.values * b.values * both).sum())
        energy_a += float((a.values**2 * both).sum())
        energy_b += float((b.values**2 * both).sum())
        pixels += float(both.sum())
    ncc = product / max(float(np.sqrt(energy_a * energy_b)), 1e-12)
    return ncc, ncc * float(np.sqrt(pixels))
