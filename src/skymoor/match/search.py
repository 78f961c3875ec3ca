# SPDX-License-Identifier: Apache-2.0
"""Search for a similarity between an image and a larger reference: rotation, scale and position are unknown.

Local features propose places. Where far more of them agree on one than on any other, that is decisive; else all
rotations and scales are tried at coarse resolution as well. Several of the best hypotheses are refined at finer
resolutions, because the correct one does not always rank first before. Dense matchers need this initial alignment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skymoor.engines.options import FIXED
from skymoor.match.channels import ChannelOptions, Channels, make_channels, rotate_channels
from skymoor.match.correlate import Target, correlate, peaks
from skymoor.match.features import Features
from skymoor.match.hypothesis import ImageHypothesis, distinct
from skymoor.match.propose import ALL_AZIMUTHS, Proposal, is_turned_within, propose
from skymoor.match.pyramid import Pyramid
from skymoor.match.reference_pyramid import LARGE_PX, Part, ReferencePyramid
from skymoor.types import Progress, Raster, no_progress

PROPOSALS = 8  # places of most features that are refined
DECISIVE, DECISIVE_RATIO = 20, 2.0
"""Features that agree on a place, and how many times those of the next: of mirror images at most 14 agree, of right
ones with a map of another season 27 to 300 (docs/benchmarks.md)."""
BORDER_PX = 40  # round parts of a large reference: what channels depend on, and how far a place moves


@dataclass(frozen=True)
class SearchOptions:
    """Resolution and extent of the search.

    Attributes:
        azimuth_step_deg: spacing of the coarse rotations, in degrees; larger where a large reference makes the image
            smaller than `template_px`.
        scale_step: ratio of consecutive coarse scales, likewise.
        template_px, reference_px: largest long sides of image and reference at the coarse level, in pixels; the image
            is never reduced to less than
        min_template_px: in a larger reference.
        min_overlap: smallest fraction of the image that lies on the reference.
        keep: number of hypotheses that are refined.
        keep_ratio: hypotheses that score below this fraction of the best are dropped; the best three always stay, as
            competitors of the best.
        fine_px: long side of the image at the finest level, in pixels.
        channels: how structural channels are made.
    """

    azimuth_step_deg: float = 6.0
    scale_step: float = 1.06
    template_px: int = 128
    reference_px: int = 512
    min_template_px: int = field(default=56, metadata=FIXED)
    min_overlap: float = 0.4
    keep: int = 12
    keep_ratio: float = field(default=0.6, metadata=FIXED)
    fine_px: int = field(default=500, metadata=FIXED)
    channels: ChannelOptions = field(default_factory=ChannelOptions, metadata=FIXED)


def search_hypotheses(
    a: Raster,
    b: Raster,
    *,
    min_scale: float,
    max_scale: float,
    options: SearchOptions | None = None,
    azimuths: tuple[float, float] = ALL_AZIMUTHS,
    features: Features | None = None,
    progress: Progress = no_progress,
) -> list[ImageHypothesis]:
    """The best hypotheses of `a` in `b`, best first and mutually distinct; scale is pixels of b per pixel of a.

    `azimuths` are the middle and the half width of those in question, in radians; `features` those of `b`, where they
    are known. Scales at which the image would not fit into the reference are skipped; the list is empty if none
    remains.
    """
    return search_in(
        ReferencePyramid(b, features),
        a,
        min_scale=min_scale,
        max_scale=max_scale,
        options=options or SearchOptions(),
        azimuths=azimuths,
        progress=progress,
    )


def search_in(
    reference: ReferencePyramid,
    a: Raster,
    *,
    min_scale: float,
    max_scale: float,
    options: SearchOptions,
    progress: Progress,
    azimuths: tuple[float, float] = ALL_AZIMUTHS,
    by_features: bool | None = None,
) -> list[ImageHypothesis]:
    """`search_hypotheses` in a reference that several searches share, so that its channels are computed once.

    With `by_features` only the places that local features propose are searched, without it all; None decides.
    """
    b = reference.raster
    search = _Search(a, reference, options)
    room = b.mask.sum() / max(1, a.mask.sum()) / options.min_overlap
    max_scale = min(max_scale, float(np.sqrt(room)))
    if max_scale < min_scale:
        return []
    limits = {"min_scale": min_scale, "max_scale": max_scale}
    proposals = propose(a, reference.features, **limits, count=PROPOSALS, azimuths=azimuths)
    alone = _decisive(proposals) if by_features is None else by_features
    start = [ImageHypothesis(one.scale, one.azimuth_rad, one.centre_px, float(one.inliers), alone) for one in proposals]
    scales, coarse = [] if alone else search.scales(min_scale, max_scale), []
    for done, scale in enumerate(scales):
        coarse += search.coarse(scale, azimuths)
        progress(done + 1, len(scales) + 1)
    found = search.refined([*distinct(coarse, a.mask.shape, options.keep), *start[: options.keep]])
    progress(len(scales) + 1, len(scales) + 1)
    return found


def refine_in(b: Raster, a: Raster, starts: Sequence[ImageHypothesis], options: SearchOptions) -> list[ImageHypothesis]:
    """Hypotheses of `a`, given in pixels of `b`, at finer and finer resolutions of it, best first.

    Those that lie beside it are left out.
    """
    return _Search(a, ReferencePyramid(b), options).refined(list(starts))


def _decisive(proposals: list[Proposal]) -> bool:
    """Whether so many local features agree on the first place, and so few on the next, that no other need be tried."""
    if not proposals:
        return False
    second = proposals[1].inliers if len(proposals) > 1 else 0
    return proposals[0].inliers >= max(DECISIVE, DECISIVE_RATIO * second)


class _Search:
    """One search: the image and the reference at all sizes that it needs."""

    def __init__(self, a: Raster, reference: ReferencePyramid, options: SearchOptions) -> None:
        self._a, self._reference = Pyramid(a), reference
        self._shape = a.mask.shape
        self._b_side = max(reference.raster.mask.shape)
        self.options = options

    def ratio(self, scale: float, template_px: int) -> float:
        """Reduction of the reference, at most 1, that makes an image at `scale` about `template_px` long."""
        for_template = template_px / (scale * max(self._shape))
        level = template_px / self.options.template_px
        least = level * self.options.min_template_px / (scale * max(self._shape))
        largest = max(level * self.options.reference_px / self._b_side, least)
        # Quantised, so that few versions of the reference are made.
        return float(min(1.0, 2 ** (np.floor(2 * np.log2(min(for_template, largest))) / 2)))

    def scales(self, min_scale: float, max_scale: float) -> list[float]:
        """Those that are searched."""
        found = [min_scale]
        while found[-1] < max_scale:
            found.append(found[-1] * self.options.scale_step ** self.coarseness(found[-1]))
        return found

    def coarseness(self, scale: float) -> float:
        """How many times the usual steps an image at this scale is searched with: as many pixels at its border."""
        ratio = self.ratio(scale, self.options.template_px)
        # Images with fewer pixels than that are searched in the reference as it is.
        return (
            1.0 if ratio >= 1 else float(max(1.0, self.options.template_px / (scale * ratio * max(self._shape)) / 1.42))
        )

    def coarse(self, scale: float, azimuths: tuple[float, float] = ALL_AZIMUTHS) -> list[ImageHypothesis]:
        """The best hypotheses at one scale over the rotations in question."""
        ratio = self.ratio(scale, self.options.template_px)
        small = self._a.at(scale * ratio)
        if min(small.mask.shape) < 16 or small.mask.sum() < 400:
            return []
        channels = make_channels(small, self.options.channels)
        target = self._target(ratio)
        found = []
        count = round(360 / (self.options.azimuth_step_deg * self.coarseness(scale)))
        for azimuth in 2 * np.pi / count * np.arange(count):
            if not is_turned_within(azimuth, (azimuths[0], azimuths[1] + np.pi / count)):
                continue
            template = rotate_channels(channels, azimuth)
            side = template.values.shape[1]
            scores = correlate(template, target, min_overlap=self.options.min_overlap)
            for v, u, score in peaks(scores, count=2, apart=side // 8):
                centre_px = ((u - side / 2 + 1) / ratio, (v - side / 2 + 1) / ratio)
                found.append(ImageHypothesis(scale, float(azimuth), centre_px, score))
        return found

    def refined(self, found: list[ImageHypothesis]) -> list[ImageHypothesis]:
        """The hypotheses at finer and finer resolutions, the best first and mutually distinct."""
        options, template_px = self.options, self.options.template_px
        azimuth_step, scale_step = np.radians(options.azimuth_step_deg) / 2, np.log(options.scale_step) / 2
        while found:
            steps = [(k * azimuth_step, k * scale_step) for k in (self.coarseness(p.scale) for p in found)]
            refined = [self.refine(p, template_px * 2, *own) for p, own in zip(found, steps, strict=True)]
            # What local features propose may lie off the reference for the most part.
            found = distinct([p for p in refined if np.isfinite(p.score)], self._shape)
            found = [p for k, p in enumerate(found) if k < 3 or p.score > options.keep_ratio * found[0].score]
            template_px, azimuth_step, scale_step = 2 * template_px, azimuth_step / 2, scale_step / 2
            if template_px >= options.fine_px or (found and self.ratio(found[0].scale, template_px) >= 1):
                break
        return found

    def refine(
        self, start: ImageHypothesis, template_px: int, azimuth_step: float, scale_step: float
    ) -> ImageHypothesis:
        """Hill climbing in rotation and scale at a finer resolution; positions are searched within a few pixels."""
        ratio = self.ratio(start.scale, template_px)
        best, part = replace(start, score=-np.inf), self._around(start, ratio)
        for step in (1.0, 0.5):
            middle = best if np.isfinite(best.score) else start
            for stretch in (-1, 0, 1):
                scale = middle.scale * float(np.exp(stretch * step * scale_step))
                channels = make_channels(self._a.at(scale * ratio), self.options.channels)
                for turn in (-1, 0, 1):
                    azimuth = middle.azimuth_rad + turn * step * azimuth_step
                    trial = self._locate(replace(middle, azimuth_rad=azimuth, scale=scale), channels, ratio, part)
                    best = max(best, trial, key=lambda p: p.score)
        return best

    def _target(self, ratio: float) -> Target:
        return self._reference.at(ratio, self.options.channels)

    def _around(self, place: ImageHypothesis, ratio: float) -> Part:
        """The reference about a place; of a small one all."""
        if ratio**2 * self._reference.raster.mask.size <= LARGE_PX:
            return Part(self._target(ratio).channels, 0.0, 0.0)
        side = int(1.2 * place.scale * ratio * float(np.hypot(*self._shape))) + 2 * BORDER_PX
        u0, v0 = (x * ratio - side / 2 for x in place.centre_px)
        part, u, v = self._reference.pyramid.window(ratio, u0, v0, side)
        return Part(make_channels(part, self.options.channels), u, v)

    def _locate(
        self,
        trial: ImageHypothesis,
        channels: Channels,
        ratio: float,
        part: Part,
        radius: int = 8,
    ) -> ImageHypothesis:
        """The best position within `radius` pixels, and its score; `channels` are the image's at the trial's scale."""
        template = rotate_channels(channels, trial.azimuth_rad)
        side, left, top = template.values.shape[1], part.left, part.top
        middle = trial.centre_px[0] * ratio - left, trial.centre_px[1] * ratio - top
        u0, v0 = (round(x - side / 2) - radius for x in middle)
        window = part.window(u0, v0, side + 2 * radius)
        scores = correlate(template, window, min_overlap=self.options.min_overlap, valid=True)
        for v, u, score in peaks(scores, count=1, apart=1):
            centre_px = ((left + u0 + u + side / 2) / ratio, (top + v0 + v + side / 2) / ratio)
            return replace(trial, centre_px=centre_px, score=score)
        return replace(trial, score=-np.inf)
