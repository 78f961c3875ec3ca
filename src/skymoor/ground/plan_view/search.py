# SPDX-License-Identifier: Apache-2.0
"""Search of a ground component in plan over scale, azimuth and place, by FFT."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from skymoor.geometry import Similarity
from skymoor.ground.plan_view.ground_colour import GroundCells
from skymoor.ground.plan_view.target import PlanTarget
from skymoor.ground.plan_view.template import PlanModel
from skymoor.types import Array, Array32, Mask, Progress, no_progress

Whole = NDArray[np.int64]

MIN_VALID = 300  # places that must be possible at a scale for its scores to be standardised
BIN_DEG = 6
APART_CELLS = 6
PEAKS = 8  # places of an azimuth at a scale whose ground is compared
USUAL_PLACES, MIN_USUAL = 16, 60  # of an azimuth, that tell how well ground agrees by chance; of all azimuths, needed
LEAST_GROUND = -1.5  # another season or parked cars speak against a place only so much


@dataclass(frozen=True)
class PlanSearchOptions:
    """Extent of the search in plan.

    Attributes:
        min_scale, max_scale: metres per unit of the level frame.
        scale_step: ratio of consecutive scales.
        azimuth_step_deg: spacing of the azimuths.
        azimuth_ratio: azimuths at which the directions of the walls of both sides agree less than so many times the
            best are passed over.
        usual_height_m, height_sigma: of the cameras, which are one level unit above the ground: log-normal.
        on_map: share of walls and of free space that must lie where heights are known.
        allowed_inside, inside_weight: share of free space within houses that is allowed, and the score that is taken
            off for the rest of it.
        keep: hypotheses that are returned.
        apart_m: distance of their cameras.
    """

    min_scale: float = 0.4
    max_scale: float = 8.0
    scale_step: float = 1.07
    azimuth_step_deg: float = 5.0
    azimuth_ratio: float = 0.5
    usual_height_m: float = 1.7
    height_sigma: float = 0.5
    on_map: float = 0.7
    allowed_inside: float = 0.02
    inside_weight: float = 15.0
    keep: int = 24
    apart_m: float = 3.0


@dataclass(frozen=True, eq=False)
class PlanHypothesis:
    """A similarity in plan of a level model; heights are not told.

    `score` is the standardised agreement with the height steps and with the ground's colours, less what contradicts it;
    `inside` the share of free space within houses.
    """

    enu_from_level: Similarity
    score: float
    inside: float


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
    azimuths = _azimuths(model, target, options)
    found: list[PlanHypothesis] = []
    for done, scale in enumerate(scales.tolist()):
        found += _at_scale(model, target, scale, azimuths, options)
        progress(done + 1, len(scales))
    return _apart(found, model, options)


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


def all_maps(
    model: PlanModel, target: PlanTarget, scale: float, azimuths: list[float], options: PlanSearchOptions
) -> list[tuple[Array32, Array32, Mask]]:
    """`_maps` at some azimuths; elements of negative index are places beyond the first row or column."""
    cell, (rows, columns) = target.grid.pixel_m, target.known.shape
    size = model.size_at(scale, cell)
    padded = fft.next_fast_len(rows + size, real=True), fft.next_fast_len(columns + size, real=True)
    layers = np.stack([*target.steps, target.raised, target.known.astype(np.float32)])
    spectra = fft.rfft2(layers, s=padded, workers=-1)
    return [_maps(*model.at(scale, azimuth, cell), spectra, padded, options) for azimuth in azimuths]


@dataclass(frozen=True)
class Usual:
    """Mean and standard deviation of the agreement over all places of a scale: with steps, and with ground."""

    steps: tuple[float, float]
    ground: tuple[float, float] | None

    def steps_score(self, agreement: Array32 | float) -> Array32 | float:
        mean, spread = self.steps
        return (agreement - mean) / spread

    def ground_score(self, agreement: Array32) -> Array32:
        """Zero where it is unknown."""
        if self.ground is None:
            return np.zeros_like(agreement)
        mean, spread = self.ground
        return np.asarray(np.nan_to_num(np.maximum((agreement - mean) / spread, LEAST_GROUND)), dtype=np.float32)


def usual(maps: list[tuple[Array32, Array32, Mask]], cells: list[GroundCells], target: PlanTarget) -> Usual | None:
    """Of all places and azimuths of a scale; None where there are too few places."""
    values = np.concatenate([steps[valid] for steps, _, valid in maps])
    if len(values) < MIN_VALID:
        return None
    steps = float(values.mean()), max(float(values.std()), 1e-9)
    if target.colour is None:
        return Usual(steps, None)
    found = []
    for (_, _, valid), own in zip(maps, cells, strict=True):
        places = np.flatnonzero(valid)
        chosen = places[np.linspace(0, len(places) - 1, USUAL_PLACES).astype(np.int64)] if len(places) else places
        found.append(own.agreement(target.colour, _corners(chosen, target, valid.shape)))
    known = np.concatenate(found)
    known = known[np.isfinite(known)]
    if len(known) < MIN_USUAL:
        return Usual(steps, None)
    return Usual(steps, (float(known.mean()), max(float(known.std()), 1e-6)))


def _corners(places: Whole, target: PlanTarget, padded: tuple[int, ...]) -> Whole:
    """Cells (n, 2), u and v, of flat places of a padded map; those beyond the target are before its first cell."""
    rows, columns = np.unravel_index(places, padded)
    height, width = target.known.shape
    u = np.where(columns >= width, columns - padded[1], columns)
    v = np.where(rows >= height, rows - padded[0], rows)
    return np.column_stack([u, v])


def penalty(inside: Array32 | float, scale: float, options: PlanSearchOptions) -> Array32 | float:
    """What is taken off a score: for free space in houses, and for an unusual height of the cameras."""
    height = np.log(scale / options.usual_height_m) / options.height_sigma
    return options.inside_weight * np.maximum(inside - options.allowed_inside, 0) + height**2 / 2  # type: ignore[no-any-return]


def _at_scale(
    model: PlanModel, target: PlanTarget, scale: float, azimuths: list[float], options: PlanSearchOptions
) -> list[PlanHypothesis]:
    """The best places at one scale; scores are standardised over all places and azimuths at this scale."""
    cell = target.grid.pixel_m
    maps = all_maps(model, target, scale, azimuths, options)
    cells = [model.ground_at(scale, azimuth, cell) for azimuth in azimuths]
    typical = usual(maps, cells, target)
    if typical is None:
        return []
    size = model.size_at(scale, cell)
    found = []
    for azimuth, own, (steps, inside, valid) in zip(azimuths, cells, maps, strict=True):
        score = typical.steps_score(steps) - penalty(inside, scale, options)
        places, values = _peaks(np.where(valid, score, -np.inf).astype(np.float32))
        corners = _corners(places, target, steps.shape)
        if target.colour is not None and len(places):
            values = values + typical.ground_score(own.agreement(target.colour, corners))
        for corner, place, value in zip(corners, places.tolist(), values.tolist(), strict=True):
            similarity = _similarity(model, target, scale, azimuth, corner + size / 2)
            found.append(PlanHypothesis(similarity, value, float(inside.flat[place])))
    return found


def _maps(
    normals: Array32, free: Array32, spectra: Array, padded: tuple[int, int], options: PlanSearchOptions
) -> tuple[Array32, Array32, Mask]:
    """Of all places: agreement with the steps, share of free space in houses, and whether enough is on the map."""
    weight = np.hypot(*normals)
    own = np.conj(fft.rfft2(np.stack([*normals, free, weight]), s=padded, workers=-1))
    steps, houses, free_known, walls_known = fft.irfft2(
        np.stack(
            [spectra[0] * own[0] + spectra[1] * own[1], spectra[2] * own[2], spectra[3] * own[2], spectra[3] * own[3]]
        ),
        s=padded,
        workers=-1,
    )
    valid = (free_known >= options.on_map * free.sum()) & (walls_known >= options.on_map * weight.sum())
    return steps, houses / np.maximum(free_known, 1.0), valid


def _peaks(score: Array32) -> tuple[Whole, Array32]:
    """Flat places and scores of the highest local maxima, best first."""
    score = score.copy()
    places, values = [], []
    for _ in range(PEAKS):
        place = int(np.argmax(score))
        row, column = np.unravel_index(place, score.shape)
        if not np.isfinite(score[row, column]):
            break
        places.append(place)
        values.append(score[row, column])
        rows, columns = (slice(max(0, int(x) - APART_CELLS), int(x) + APART_CELLS + 1) for x in (row, column))
        score[rows, columns] = -np.inf
    return np.array(places, dtype=np.int64), np.array(values, dtype=np.float32)


def _similarity(model: PlanModel, target: PlanTarget, scale: float, azimuth: float, centre_px: Array) -> Similarity:
    c, s = np.cos(azimuth), np.sin(azimuth)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    east_north = target.grid.enu_from_px(centre_px[None])[0]
    source = np.array([*model.centre, 0.0])
    return Similarity(scale, rotation, np.array([*east_north, 0.0]) - scale * rotation @ source)


def _apart(found: list[PlanHypothesis], model: PlanModel, options: PlanSearchOptions) -> list[PlanHypothesis]:
    """Best first, without those whose cameras are near those of a better one."""
    kept: list[PlanHypothesis] = []
    places: list[Array] = []
    for one in sorted(found, key=lambda hypothesis: -hypothesis.score):
        place = one.enu_from_level.apply(model.cameras)[:, :2]
        if all(np.linalg.norm(place - other, axis=1).mean() >= options.apart_m for other in places):
            kept.append(one)
            places.append(place)
            if len(kept) == options.keep:
                break
    return kept
