# SPDX-License-Identifier: Apache-2.0
"""Places of an image in a large reference, from local features whose size and direction tell a similarity each."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.match.features import Features, features_of, nearest
from skymoor.match.pyramid import Pyramid
from skymoor.types import Array, Raster

NEIGHBOURS = 3  # matches of a feature: the right one of many alike is often not the nearest
MIN_SIDE_PX = 48  # of the image at the least size of which features are taken
LOG_SCALE, AZIMUTH, SHIFT = 0.4, np.radians(24.0), 0.25  # bins of votes; shifts in sides of the image
TRIED = 60  # bins, those of most votes
TOLERANCE_PX = 3.0  # in which the features of the reference were found
ALL_AZIMUTHS = (0.0, float(np.pi))


@dataclass(frozen=True)
class Proposal:
    """A similarity as in `ImageHypothesis`, and the number of features that agree on it."""

    scale: float
    azimuth_rad: float
    centre_px: tuple[float, float]
    inliers: int


def image_features(image: Raster, min_scale: float, max_scale: float) -> Features:
    """Features of an image, in its own pixels, at the sizes that it may have in what it is compared with.

    The sizes are a factor of two apart; scales are pixels of the other per pixel of the image.
    """
    pyramid, parts, ratio = Pyramid(image), [], min(max_scale, 1.0)
    while True:
        found = features_of(pyramid.at(ratio))
        parts.append(Features(found.px / ratio, found.size / ratio, found.angle, found.descriptors))
        ratio /= 2
        if ratio < min_scale / np.sqrt(2) or ratio * max(image.mask.shape) < MIN_SIDE_PX:
            return Features.joined(parts)


def propose(
    image: Raster,
    reference: Features,
    *,
    min_scale: float,
    max_scale: float,
    count: int,
    azimuths: tuple[float, float] = ALL_AZIMUTHS,
) -> list[Proposal]:
    """Up to `count` places at which most features agree, best first.

    Args:
        image: what is searched.
        reference: features of the raster in which it is searched.
        min_scale, max_scale: pixels of the reference per pixel of the image.
        azimuths: middle and half width of the azimuths in question, radians.
    """
    own = image_features(image, min_scale / reference.pixel, max_scale / reference.pixel)
    if len(own) < 3 or len(reference) < NEIGHBOURS:
        return []
    middle = np.array(image.mask.shape[::-1]) / 2
    query = np.repeat(np.arange(len(own)), NEIGHBOURS)
    found = nearest(own, reference, NEIGHBOURS).ravel()
    log_scale = np.log(reference.size[found] / own.size[query])
    allowed = (log_scale > np.log(min_scale) - LOG_SCALE) & (log_scale < np.log(max_scale) + LOG_SCALE)
    query, found, log_scale = query[allowed], found[allowed], log_scale[allowed]
    votes = _votes(own, reference, query, found, log_scale, middle)
    side = float(max(image.mask.shape))
    proposals = []
    for chosen in _fullest(votes, side, query):
        fitted = _fitted(
            own.px[query[chosen]], reference.px[found[chosen]], query[chosen], middle, TOLERANCE_PX * reference.pixel
        )
        if fitted is None or not min_scale / 1.1 <= fitted.scale <= 1.1 * max_scale:
            continue
        if is_turned_within(fitted.azimuth_rad, azimuths):
            proposals.append(fitted)
    return _apart(proposals, side)[:count]


def is_turned_within(azimuth_rad: float, azimuths: tuple[float, float]) -> bool:
    """Whether an azimuth is in a range, given by its middle and half width in radians."""
    return bool(abs((azimuth_rad - azimuths[0] + np.pi) % (2 * np.pi) - np.pi) <= azimuths[1] + 1e-9)


def _votes(
    own: Features,
    reference: Features,
    query: NDArray[np.int64],
    found: NDArray[np.int64],
    log_scale: Array,
    middle: Array,
) -> Array:
    """Log scale, azimuth and position (n, 4) of the image's middle in the reference, of each match."""
    azimuth = (reference.angle[found] - own.angle[query]) % (2 * np.pi)
    c, s = np.exp(log_scale) * np.cos(azimuth), np.exp(log_scale) * np.sin(azimuth)
    arm = middle - own.px[query]
    moved = np.column_stack([c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]])
    return np.column_stack([log_scale, azimuth, reference.px[found] + moved])


def _fullest(votes: Array, side: float, query: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """The matches of the bins that most features vote for; bins overlap by half."""
    found: dict[tuple[int, ...], NDArray[np.int64]] = {}
    for offset in np.ndindex(2, 2, 2, 2):
        half = np.array(offset) / 2
        level = np.floor(votes[:, 0] / LOG_SCALE + half[0])
        width = SHIFT * side * np.exp((level + 0.5 - half[0]) * LOG_SCALE)
        turn = np.floor(votes[:, 1] / AZIMUTH + half[1]) % round(2 * np.pi / AZIMUTH)
        place = np.floor(votes[:, 2:] / width[:, None] + half[2:])
        keys = np.column_stack([level, turn, place]).astype(np.int64)
        order = np.lexsort(keys.T)
        ends = np.flatnonzero((np.diff(keys[order], axis=0) != 0).any(axis=1)) + 1
        for group in np.split(order, ends):
            if len(group) >= 3:
                found[(*offset, *keys[group[0]].tolist())] = group
    ranked = sorted(found.values(), key=lambda group: -len(np.unique(query[group])))
    return ranked[:TRIED]


def _fitted(a: Array, b: Array, query: NDArray[np.int64], middle: Array, tolerance: float) -> Proposal | None:
    """The similarity on which most of the matches of a bin agree."""
    matrix, inliers = cv2.estimateAffinePartial2D(
        a, b, method=cv2.RANSAC, ransacReprojThreshold=tolerance, maxIters=500, confidence=0.995
    )
    if matrix is None or not np.isfinite(matrix).all():
        return None
    scale = float(np.hypot(matrix[0, 0], matrix[1, 0]))
    if scale < 1e-6:
        return None
    azimuth = float(np.arctan2(matrix[1, 0], matrix[0, 0]))
    u, v = (matrix @ [*middle, 1.0]).tolist()
    count = len(np.unique(query[inliers.ravel() > 0]))
    return Proposal(scale, azimuth, (u, v), count) if count >= 3 else None


def _apart(proposals: list[Proposal], side: float) -> list[Proposal]:
    """Best first, without repetitions of a better one."""
    kept: list[Proposal] = []
    for one in sorted(proposals, key=lambda proposal: -proposal.inliers):
        far = (np.hypot(*np.subtract(one.centre_px, other.centre_px)) > 0.12 * side * other.scale for other in kept)
        if all(far):
            kept.append(one)
    return kept
