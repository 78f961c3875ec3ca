# SPDX-License-Identifier: Apache-2.0
"""Search of one facade orthophoto in others over scale and shift: both are upright, so no rotation is searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skymoor.match.channels import N_COLOUR, ChannelOptions, Channels, make_channels
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
        min_overlap: share of the template that must lie on the other image.
        per_pair: hypotheses that are kept of each pair of images at each scale.
        apart_px: distance between those.
        sharp, blurred: channels of the searched images, taken from near, and of the others, taken from far: the former
            are smoothed more, for equal resolution.
    """

    scale_step: float = 1.04
    min_overlap: float = 0.3
    per_pair: int = 3
    apart_px: int = 8
    sharp: ChannelOptions = field(default_factory=lambda: ChannelOptions(smooth_px=1.3))
    blurred: ChannelOptions = field(default_factory=ChannelOptions)


@dataclass(frozen=True)
class FacadeHypothesis:
    """Image `a` in image `b`: pixel p of a is at `scale * p + offset_px` of b; `score` as of `correlate`."""

    a: int
    b: int
    scale: float
    offset_px: tuple[float, float]
    score: float

    @property
    def matrix(self) -> Array:
        """(2, 3) affine, pixels of b from pixels of a."""
        return np.array([[self.scale, 0.0, self.offset_px[0]], [0.0, self.scale, self.offset_px[1]]])


def search_facades(
    images: Sequence[Raster],
    others: Sequence[Raster],
    *,
    min_scale: float,
    max_scale: float,
    options: FacadeSearchOptions | None = None,
    progress: Progress = no_progress,
) -> list[FacadeHypothesis]:
    """Hypotheses of each image in each of the others, best first; scale is pixels of the other per pixel of the image.

    Images that are too small at a scale, and others with hardly any content, are passed over.
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
    for a, image in enumerate(images):
        pyramid = Pyramid(image)
        for scale in scales:
            found += _at_scale(a, pyramid, float(scale), targets, options)
        progress(a + 1, len(images))
    return sorted(found, key=lambda one: -one.score)


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
    """Agreement of two images at zero shift, `here`, and at the best shift within reach, `there`, which is `px`.

    Scores are as of `correlate`; `px` is the shift (u, v) of the first image.
    """

    here: float
    there: float
    px: tuple[float, float]


def drift(
    ground: Raster, airborne: Raster, *, reach_px: int, still_px: int, options: FacadeSearchOptions | None = None
) -> Drift | None:
    """Agreement of a ground orthophoto with an airborne one of the same size; None where they overlap too little.

    Shifts up to `still_px` count as `here`; `reach_px` is the largest that is tried.
    """
    options = options or FacadeSearchOptions()
    if min(ground.mask.sum(), airborne.mask.sum()) < FEWEST_PX:
        return None
    template = make_channels(ground, options.sharp)
    scores = correlate(template, Target(make_channels(airborne, options.blurred)), min_overlap=options.min_overlap)
    v0, u0 = ground.mask.shape[0] - 1, ground.mask.shape[1] - 1
    top, left = max(v0 - reach_px, 0), max(u0 - reach_px, 0)
    window = scores[top : v0 + reach_px + 1, left : u0 + reach_px + 1]
    still = scores[max(v0 - still_px, 0) : v0 + still_px + 1, max(u0 - still_px, 0) : u0 + still_px + 1]
    for v, u, there in peaks(window, count=1, apart=1):
        return Drift(max(float(still.max()), 0.0), there, (u + left - u0, v + top - v0))
    return None


def agreement(
    pairs: Sequence[tuple[Raster, Raster]], options: FacadeSearchOptions | None = None
) -> tuple[float, float]:
    """NCC of registered images, pooled over all pairs, and the score: NCC times the root of the number of pixels.

    The first of each pair is the ground orthophoto, resampled to the pixels of the second.
    """
    options = options or FacadeSearchOptions()
    return agreement_of_channels(
        [(make_channels(ground, options.sharp), make_channels(airborne, options.blurred)) for ground, airborne in pairs]
    )


def agreement_of_channels(pairs: Sequence[tuple[Channels, Channels]]) -> tuple[float, float]:
    """See `agreement`."""
    product = energy_a = energy_b = pixels = 0.0
    for a, b in pairs:
        both = a.known[0] * b.known[0]
        product += float(np.vdot(a.values[:N_COLOUR] * both, b.values[:N_COLOUR]))
        energy_a += float(np.vdot(a.values[:N_COLOUR] * both, a.values[:N_COLOUR]))
        energy_b += float(np.vdot(b.values[:N_COLOUR] * both, b.values[:N_COLOUR]))
        pixels += float(both.sum())
    ncc = product / max(float(np.sqrt(energy_a * energy_b)), 1e-12)
    return ncc, ncc * float(np.sqrt(pixels))
