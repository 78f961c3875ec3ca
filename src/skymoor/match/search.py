# SPDX-License-Identifier: Apache-2.0
"""Where an image of unknown heading, scale and place lies in a larger one.

All headings and scales are tried at a coarse pixel; the best hypotheses are refined at finer pixels, several of them,
because at the coarse pixel the right one is not always the first. Any dense matcher needs this in front.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from skymoor.engines.options import FIXED
from skymoor.match.channels import ChannelOptions, Channels, make_channels, rotate_angles
from skymoor.match.correlate import Target, correlate, peaks
from skymoor.match.pyramid import Pyramid
from skymoor.types import Array, Progress, Raster, no_progress


@dataclass(frozen=True)
class ImageHypothesis:
    """Pixel p of the image lies at `scale * turn(p - centre) + place` of the reference, both in pixels.

    `turn` rotates by `azimuth_rad` from u towards v; `centre` is the middle of the image. `score` is the agreement
    in standard deviations above chance; it compares with scores of the same level of refinement.
    """

    scale: float
    azimuth_rad: float
    place: tuple[float, float]
    score: float

    def matrix(self, shape: tuple[int, int]) -> Array:
        """(2, 3) affine from the pixels of an image of `shape` to the reference's."""
        c, s = self.scale * np.cos(self.azimuth_rad), self.scale * np.sin(self.azimuth_rad)
        linear = np.array([[c, -s], [s, c]])
        centre = np.array([shape[1] / 2, shape[0] / 2])
        return np.column_stack([linear, np.array(self.place) - linear @ centre])


@dataclass(frozen=True)
class SearchOptions:
    """Size of the search.

    Attributes:
        heading_step_deg, scale_step: spacing of the coarse hypotheses.
        template_px, reference_px: largest long sides of image and reference at the coarse level.
        min_overlap: share of the image that must lie on the reference.
        keep: hypotheses that are refined.
        keep_ratio: a hypothesis whose score falls below this share of the best is dropped, but three are kept always:
            how good the best wrong answer is says how good the best one is.
        fine_px: long side of the image at the finest level.
    """

    heading_step_deg: float = 6.0
    scale_step: float = 1.06
    template_px: int = 128
    reference_px: int = 512
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
    progress: Progress = no_progress,
) -> list[ImageHypothesis]:
    """The best places of `a` in `b`, best first, distinct from each other; scale is pixels of b per pixel of a.

    Scales at which the reference could not hold the image are left out. An empty list says that none is left.
    """
    options = options or SearchOptions()
    return search_in(Sized(b), a, min_scale=min_scale, max_scale=max_scale, options=options, progress=progress)


def search_in(
    reference: Sized, a: Raster, *, min_scale: float, max_scale: float, options: SearchOptions, progress: Progress
) -> list[ImageHypothesis]:
    """The same in a reference in which other images are searched, too: what is made of it is made once."""
    b = reference.raster
    search = _Search(a, reference, options)
    room = b.mask.sum() / max(1, a.mask.sum()) / options.min_overlap
    max_scale = min(max_scale, float(np.sqrt(room)))
    if max_scale < min_scale:
        return []
    steps = int(np.log(max_scale / min_scale) / np.log(options.scale_step)) + 1
    scales = [min_scale * options.scale_step**k for k in range(steps + 1)]
    found: list[ImageHypothesis] = []
    for done, scale in enumerate(scales):
        found += search.coarse(scale)
        progress(done + 1, len(scales) + 1)
    found = distinct(found, a.mask.shape)[: options.keep]
    template_px = options.template_px
    heading_step, scale_step = np.radians(options.heading_step_deg) / 2, np.log(options.scale_step) / 2
    while found:
        refined = [search.refine(p, template_px * 2, heading_step, scale_step) for p in found]
        found = distinct(refined, a.mask.shape)
        found = [p for k, p in enumerate(found) if k < 3 or p.score > options.keep_ratio * found[0].score]
        template_px, heading_step, scale_step = 2 * template_px, heading_step / 2, scale_step / 2
        if template_px >= options.fine_px or search.ratio(found[0].scale, template_px) >= 1:
            break
    progress(len(scales) + 1, len(scales) + 1)
    return found


def distinct(hypotheses: list[ImageHypothesis], shape: tuple[int, int]) -> list[ImageHypothesis]:
    """Best first, without those that nearly repeat a better one."""
    kept: list[ImageHypothesis] = []
    for p in sorted(hypotheses, key=lambda p: -p.score):
        if all(not alike(p, q, shape) for q in kept):
            kept.append(p)
    return kept


def alike(p: ImageHypothesis, q: ImageHypothesis, shape: tuple[int, int]) -> bool:
    """Whether two hypotheses are the same answer up to a refinement."""
    turn = abs((p.azimuth_rad - q.azimuth_rad + np.pi) % (2 * np.pi) - np.pi)
    apart = np.hypot(p.place[0] - q.place[0], p.place[1] - q.place[1])
    near = 0.12 * max(shape) * max(p.scale, q.scale)
    return bool(turn < np.radians(15) and abs(np.log(p.scale / q.scale)) < 0.2 and apart < near)


class Sized:
    """A reference with its channels and spectra at every size that searches ask for."""

    def __init__(self, raster: Raster) -> None:
        self.raster = raster
        self._pyramid = Pyramid(raster)
        self._targets: dict[tuple[float, ChannelOptions], Target] = {}

    def at(self, ratio: float, options: ChannelOptions) -> Target:
        """Reduced to this share of its size."""
        if (ratio, options) not in self._targets:
            self._targets[ratio, options] = Target(make_channels(self._pyramid.at(ratio), options))
        return self._targets[ratio, options]


class _Search:
    """Both images at every size that the search asks for."""

    def __init__(self, a: Raster, reference: Sized, options: SearchOptions) -> None:
        self._a, self._reference = Pyramid(a), reference
        self._shape = a.mask.shape
        self._b_side = max(reference.raster.mask.shape)
        self._options = options

    def ratio(self, scale: float, template_px: int) -> float:
        """By how much the reference is reduced for an image at `scale` to be about `template_px` long, at most 1."""
        wanted = template_px / (scale * max(self._shape))
        largest = template_px / self._options.template_px * self._options.reference_px / self._b_side
        # Quantised, so that few versions of the reference are made.
        return float(min(1.0, 2 ** (np.floor(2 * np.log2(min(wanted, largest))) / 2)))

    def coarse(self, scale: float) -> list[ImageHypothesis]:
        """The best places at one scale over all headings."""
        ratio = self.ratio(scale, self._options.template_px)
        small = self._a.at(scale * ratio)
        if min(small.mask.shape) < 16 or small.mask.sum() < 400:
            return []
        channels = make_channels(small, self._options.channels)
        target = self._target(ratio)
        found = []
        for heading in np.radians(np.arange(0, 360, self._options.heading_step_deg)):
            template = turn(channels, heading)
            side = template.values.shape[1]
            scores = correlate(template, target, min_overlap=self._options.min_overlap)
            for v, u, score in peaks(scores, count=2, apart=side // 8):
                place = ((u - side / 2 + 1) / ratio, (v - side / 2 + 1) / ratio)
                found.append(ImageHypothesis(scale, float(heading), place, score))
        return found

    def refine(
        self, start: ImageHypothesis, template_px: int, heading_step: float, scale_step: float
    ) -> ImageHypothesis:
        """Climb in heading and scale at a finer pixel; the place is searched within a few pixels each time."""
        ratio = self.ratio(start.scale, template_px)
        best = replace(start, score=-np.inf)
        for step in (1.0, 0.5):
            middle = best if np.isfinite(best.score) else start
            for stretch in (-1, 0, 1):
                scale = middle.scale * float(np.exp(stretch * step * scale_step))
                channels = make_channels(self._a.at(scale * ratio), self._options.channels)
                for turned in (-1, 0, 1):
                    heading = middle.azimuth_rad + turned * step * heading_step
                    trial = self._place(replace(middle, azimuth_rad=heading, scale=scale), channels, ratio)
                    best = max(best, trial, key=lambda p: p.score)
        return best

    def _target(self, ratio: float) -> Target:
        return self._reference.at(ratio, self._options.channels)

    def _place(self, trial: ImageHypothesis, channels: Channels, ratio: float, reach: int = 8) -> ImageHypothesis:
        """The best place within `reach` pixels, and its score; `channels` are the image's at the trial's scale."""
        template = turn(channels, trial.azimuth_rad)
        side = template.values.shape[1]
        u0, v0 = (round(x * ratio - side / 2) - reach for x in trial.place)
        window = cut(self._target(ratio).channels, u0, v0, side + 2 * reach)
        scores = correlate(template, Target(window), min_overlap=self._options.min_overlap, valid=True)
        for v, u, score in peaks(scores, count=1, apart=1):
            place = ((u0 + u + side / 2) / ratio, (v0 + v + side / 2) / ratio)
            return replace(trial, place=place, score=score)
        return replace(trial, score=-np.inf)


def turn(channels: Channels, heading: float) -> Channels:
    """Channels of the turned image, in a square that holds every heading."""
    h, w = channels.values.shape[1:]
    side = int(np.ceil(np.hypot(h, w))) + 2
    c, s = np.cos(heading), np.sin(heading)
    linear = np.array([[c, -s], [s, c]])
    offset = side / 2 - linear @ [w / 2, h / 2]
    # OpenCV counts from the centre of the first pixel.
    matrix = np.column_stack([linear, offset + linear @ [0.5, 0.5] - 0.5])
    stack = np.concatenate([channels.values, channels.known])
    turned = np.stack([cv2.warpAffine(x, matrix, (side, side), flags=cv2.INTER_LINEAR) for x in stack])
    return Channels(rotate_angles(turned[:-2], heading), turned[-2:])


def cut(channels: Channels, u0: int, v0: int, side: int) -> Channels:
    """A square window whose first pixel is (u0, v0), zero beyond the image."""
    h, w = channels.values.shape[1:]
    stack = np.concatenate([channels.values, channels.known])
    window = np.zeros((len(stack), side, side), np.float32)
    us, ue, vs, ve = max(0, u0), min(w, u0 + side), max(0, v0), min(h, v0 + side)
    if us < ue and vs < ve:
        window[:, vs - v0 : ve - v0, us - u0 : ue - u0] = stack[:, vs:ve, us:ue]
    return Channels(window[:-2], window[-2:])
