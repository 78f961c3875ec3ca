# SPDX-License-Identifier: Apache-2.0
"""Search of a ground component in plan over scale, azimuth and place: by FFT in large cells, then point by point."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from skymoor.engines.options import FIXED
from skymoor.geometry import Similarity
from skymoor.ground.plan_view.posterior import moved
from skymoor.ground.plan_view.score import LEAST_GROUND, PlanScores, ScoreOptions
from skymoor.ground.plan_view.target import PlanTarget
from skymoor.ground.plan_view.template import PlanModel, ScaledModel
from skymoor.types import Array, Array32, Mask, Progress, no_progress

Whole = NDArray[np.int64]

MIN_VALID = 80  # places that must be possible at a scale for its scores to be standardised
BIN_DEG = 6
APART_CELLS = 3
COARSER_FROM_M = 3.3  # metres per unit: details of a component are as large as cells four times as large then
REACH = 2  # cells of the map: half a large one and what rounding adds
PEAKS = 8  # places of an azimuth at a scale


@dataclass(frozen=True)
class PlanSearchOptions:
    """Extent of the search in plan.

    Attributes:
        min_scale, max_scale: metres per unit of the level frame.
        scale_step: ratio of consecutive scales.
        azimuth_step_deg: spacing of the azimuths.
        azimuth_ratio: azimuths at which the directions of the walls of both sides agree less than so many times the
            best are passed over.
        screened: places in large cells that are scored in the map's own.
        keep: hypotheses that are returned.
        apart_m: distance of their cameras.
        score: how they are scored.
    """

    min_scale: float = 0.4
    max_scale: float = 8.0
    scale_step: float = 1.1
    azimuth_step_deg: float = 6.0
    azimuth_ratio: float = 0.5
    screened: int = 120
    keep: int = 24
    apart_m: float = 3.0
    score: ScoreOptions = field(default_factory=ScoreOptions, metadata=FIXED)


@dataclass(frozen=True, eq=False)
class PlanHypothesis:
    """A similarity in plan of a level model; heights are not told.

    `score` is the standardised agreement with the height steps and with the ground's colours, less what contradicts it.
    """

    enu_from_level: Similarity
    score: float


def search_plan(
    model: PlanModel,
    target: PlanTarget,
    options: PlanSearchOptions | None = None,
    *,
    progress: Progress = no_progress,
) -> list[PlanHypothesis]:
    """Hypotheses of a component on the height steps, best first and mutually apart; empty where it fits nowhere."""
    options = options or PlanSearchOptions()
    count = int(np.log(options.max_scale / options.min_scale) / np.log(options.scale_step)) + 1
    scales = options.min_scale * options.scale_step ** np.arange(count)
    azimuths, coarse = _azimuths(model, target, options), target.halved()
    coarser = coarse.halved()
    found: list[PlanHypothesis] = []
    for done, scale in enumerate(scales.tolist()):
        found += _at_scale(model, coarser if scale > COARSER_FROM_M else coarse, scale, azimuths, options)
        progress(done + 1, len(scales) + 1)
    scores = PlanScores(model, target, options.score)
    screened = _apart(found, model, options.apart_m, options.screened)
    finer = _finer(scores, screened, np.zeros((1, 2)), options)
    best = sorted(finer, key=lambda hypothesis: -hypothesis.score)[: 2 * options.keep]
    half = np.log(options.scale_step) / 2, np.radians(options.azimuth_step_deg) / 2
    turns = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2) * half
    finer = _finer(scores, best, turns, options)
    progress(len(scales) + 1, len(scales) + 1)
    return _apart(finer, model, options.apart_m, options.keep)


def _azimuths(model: PlanModel, target: PlanTarget, options: PlanSearchOptions) -> list[float]:
    """Rotations (radians) at which directions of walls agree with directions of height steps."""
    own, theirs = _directions(*model.normals), _directions(*target.steps)
    bins = len(own)
    # Rotated counter-clockwise by k bins, a direction of bin i is in bin i + k.
    agreement = np.array([own @ np.roll(theirs, -k) for k in range(bins)])
    step = options.azimuth_step_deg
    tried = np.arange(0.0, 360.0, step)
    near = np.round(tried / BIN_DEG).astype(int) % bins
    best = np.maximum.reduce([agreement[(near + k) % bins] for k in (-1, 0, 1)])
    return [float(np.radians(a)) for a in tried[best >= options.azimuth_ratio * agreement.max()]]


def _directions(u: Array32, v: Array32) -> Array:
    """Histogram of directions in plan, counter-clockwise from east; v runs down."""
    angle = np.degrees(np.arctan2(-v, u)).ravel() % 360
    bins = np.minimum((angle / BIN_DEG).astype(int), 360 // BIN_DEG - 1)
    counts = np.bincount(bins, np.hypot(u, v).ravel() ** 2, minlength=360 // BIN_DEG)
    return np.asarray(counts / max(float(np.linalg.norm(counts)), 1e-12))


def _at_scale(
    model: PlanModel, target: PlanTarget, scale: float, azimuths: list[float], options: PlanSearchOptions
) -> list[PlanHypothesis]:
    """The best places at one scale; scores are standardised over all places and azimuths at this scale."""
    cell, (rows, columns) = target.grid.pixel_m, target.known.shape
    scaled = model.at_scale(scale, cell)
    size = scaled.size
    padded = fft.next_fast_len(rows + size, real=True), fft.next_fast_len(columns + size, real=True)
    layers = [*target.steps, target.raised, target.known.astype(np.float32)]
    layers += [] if target.colour is None else list(target.colour.local)
    spectra = fft.rfft2(np.stack(layers), s=padded, workers=-1)
    maps = [_maps(scaled, azimuth, spectra, padded, options.score) for azimuth in azimuths]
    steps, shades = (np.concatenate([one[k][one[3]] for one in maps]) for k in (0, 2))
    if len(steps) < MIN_VALID:
        return []
    found = []
    for azimuth, (agreement, inside, colours, valid) in zip(azimuths, maps, strict=True):
        score = (agreement - steps.mean()) / max(float(steps.std()), 1e-9) - options.score.penalty(inside, scale)
        score = score + np.maximum((colours - shades.mean()) / max(float(shades.std()), 1e-9), LEAST_GROUND)
        for row, column, value in _peaks(np.where(valid, score, -np.inf).astype(np.float32)):
            u = column - padded[1] if column >= columns else column
            v = row - padded[0] if row >= rows else row
            similarity = _similarity(model, target, scale, azimuth, np.array([u, v]) + size / 2)
            found.append(PlanHypothesis(similarity, value))
    return found


def _maps(
    scaled: ScaledModel, azimuth: float, spectra: Array, padded: tuple[int, int], options: ScoreOptions
) -> tuple[Array32, Array32, Array32, Mask]:
    """Of all places: agreement with the steps, share of free space in houses, agreement of the ground, whether enough
    is on the map; elements of negative index are places beyond the first row or column.
    """
    normals, free = scaled.turned(azimuth)
    weight = np.hypot(*normals)
    own = np.conj(fft.rfft2(np.stack([*normals, free, weight]), s=padded, workers=-1))
    products = [spectra[0] * own[0] + spectra[1] * own[1], *(spectra[2:4] * own[2]), spectra[3] * own[3]]
    if len(spectra) > len(own):
        ground = scaled.turned_ground(azimuth).layers(scaled.size)
        products.append((spectra[4:] * np.conj(fft.rfft2(ground, s=padded, workers=-1))).sum(axis=0))
    steps, houses, free_known, walls_known, *colours = fft.irfft2(np.stack(products), s=padded, workers=-1)
    valid = (free_known >= options.on_map * free.sum()) & (walls_known >= options.on_map * weight.sum())
    inside = houses / np.maximum(free_known, 1.0)
    return steps, inside, colours[0] if colours else np.zeros_like(steps), valid


def _peaks(score: Array32) -> list[tuple[int, int, float]]:
    """Rows, columns and scores of the highest local maxima, best first."""
    score, found = score.copy(), []
    for _ in range(PEAKS):
        row, column = (int(x) for x in np.unravel_index(int(np.argmax(score)), score.shape))
        if not np.isfinite(score[row, column]):
            break
        found.append((row, column, float(score[row, column])))
        rows, columns = (slice(max(0, x - APART_CELLS), x + APART_CELLS + 1) for x in (row, column))
        score[rows, columns] = -np.inf
    return found


def _similarity(model: PlanModel, target: PlanTarget, scale: float, azimuth: float, centre_px: Array) -> Similarity:
    c, s = np.cos(azimuth), np.sin(azimuth)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    east_north = target.grid.enu_from_px(centre_px[None])[0]
    source = np.array([*model.centre, 0.0])
    return Similarity(scale, rotation, np.array([*east_north, 0.0]) - scale * rotation @ source)


def _finer(
    scores: PlanScores, hypotheses: list[PlanHypothesis], turns: Array, options: PlanSearchOptions
) -> list[PlanHypothesis]:
    """Each hypothesis at its best place within the large cells, of some changes (n, 2) of log scale and azimuth."""
    pivot, cell, found = scores.model.cameras, scores.target.grid.pixel_m, []
    for hypothesis in hypotheses:
        best = None
        for log_scale, azimuth in turns:
            turned = moved(hypothesis.enu_from_level, np.array([log_scale, azimuth, 0.0, 0.0]), pivot)
            values = np.nan_to_num(scores.around(turned, REACH), nan=-np.inf)
            row, column = np.unravel_index(int(np.argmax(values)), values.shape)
            if values[row, column] > (-np.inf if best is None else best.score) and _within(turned.scale, options):
                shift = cell * np.array([0.0, 0.0, column - REACH, REACH - row])
                best = PlanHypothesis(moved(turned, shift, pivot), float(values[row, column]))
        found += [] if best is None else [best]
    return found


def _within(scale: float, options: PlanSearchOptions) -> bool:
    return options.min_scale * (1 - 1e-6) <= scale <= options.max_scale * (1 + 1e-6)


def _apart(found: list[PlanHypothesis], model: PlanModel, apart_m: float, count: int) -> list[PlanHypothesis]:
    """The best first, without those whose cameras are near those of a better one."""
    kept: list[PlanHypothesis] = []
    places = np.zeros((0, len(model.cameras), 2))
    for one in sorted(found, key=lambda hypothesis: -hypothesis.score):
        place = one.enu_from_level.apply(model.cameras)[:, :2]
        if (np.linalg.norm(places - place, axis=2).mean(axis=1) >= apart_m).all():
            kept.append(one)
            places = np.concatenate([places, place[None]])
            if len(kept) == count:
                break
    return kept
