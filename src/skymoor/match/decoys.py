# SPDX-License-Identifier: Apache-2.0
"""Null distribution of the search score, from decoys of the render in the same reference.

A decoy is a mirrored copy of the render, as it is or stretched along some direction: it keeps edges, textures and
heights as a whole, but matches nowhere. Decoys are searched like the render, over the same rotations, scales and
positions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.engines.options import FIXED
from skymoor.match.features import Features
from skymoor.match.hypothesis import ImageHypothesis
from skymoor.match.propose import ALL_AZIMUTHS
from skymoor.match.reference_pyramid import ReferencePyramid
from skymoor.match.search import SearchOptions, search_in
from skymoor.types import Progress, Raster, no_progress

MIN_DECOYS = 2


@dataclass(frozen=True)
class DecoyOptions:
    """Number and making of decoys.

    Attributes:
        count: largest number of decoys: the mirrored image, then the same stretched along directions in turn.
        stretch: by which it is longer along the direction, and shorter across it: enough for another layout, and not
            for other edges and textures.
        keep: hypotheses refined per decoy.
    """

    count: int = 4
    stretch: float = field(default=1.15, metadata=FIXED)
    keep: int = field(default=4, metadata=FIXED)


def search_decoys(
    a: Raster,
    b: Raster,
    *,
    min_scale: float,
    max_scale: float,
    options: SearchOptions | None = None,
    decoys: DecoyOptions | None = None,
    azimuths: tuple[float, float] = ALL_AZIMUTHS,
    features: Features | None = None,
    by_features: bool | None = None,
    enough: Callable[[Sequence[float]], bool] = lambda _: False,
    progress: Progress = no_progress,
) -> list[tuple[Raster, ImageHypothesis]]:
    """Decoys of `a` with their best hypotheses in `b`: null samples for those of `search_hypotheses`.

    Arguments are those of `search_hypotheses`; `by_features` says how that found what they are compared with. From the
    second decoy on, the loop stops early once `enough(scores)` is true: each decoy costs as much as the search.
    """
    decoys = decoys or DecoyOptions()
    options = replace(options or SearchOptions(), keep=decoys.keep)
    reference = ReferencePyramid(b, features)
    best: list[tuple[Raster, ImageHypothesis]] = []
    for decoy in make_decoys(a, decoys):
        found = search_in(
            reference,
            decoy,
            min_scale=min_scale,
            max_scale=max_scale,
            options=options,
            progress=no_progress,
            azimuths=azimuths,
            by_features=by_features,
        )
        best += [(decoy, found[0])] if found else []
        if len(best) >= MIN_DECOYS and enough([hypothesis.score for _, hypothesis in best]):
            break
        progress(len(best), decoys.count)
    progress(decoys.count, decoys.count)
    return best


def decoy_scores(a: Raster, b: Raster, **arguments: Any) -> list[float]:
    """The best score of each decoy; arguments are those of `search_decoys`."""
    return [hypothesis.score for _, hypothesis in search_decoys(a, b, **arguments)]


def make_decoys(a: Raster, options: DecoyOptions) -> Iterator[Raster]:
    """Up to `options.count` decoys of `a`, with masks and heights."""
    flipped, stretches = mirrored(a), options.count - 1
    if options.count:
        yield flipped
    for k in range(stretches):
        yield stretched(flipped, options.stretch, np.pi * k / stretches)


def mirrored(a: Raster) -> Raster:
    """`a` flipped left to right."""
    height = None if a.height is None else np.ascontiguousarray(a.height[:, ::-1])
    return Raster(np.ascontiguousarray(a.rgb[:, ::-1]), np.ascontiguousarray(a.mask[:, ::-1]), height)


def stretched(a: Raster, factor: float, direction_rad: float) -> Raster:
    """`a` longer by `factor` along a direction, from columns towards rows, and shorter by it across: of equal area."""
    c, s = np.cos(direction_rad), np.sin(direction_rad)
    along = np.array([[c, -s], [s, c]])
    linear = along @ np.diag([factor, 1 / factor]) @ along.T
    rows, columns = a.mask.shape
    corners = np.array([[0, 0], [columns, 0], [0, rows], [columns, rows]]) @ linear.T
    size = np.ceil(np.ptp(corners, axis=0)).astype(int)
    # Half a pixel: OpenCV's coordinates are of the middles of pixels.
    matrix = np.column_stack([linear, linear @ [0.5, 0.5] - 0.5 - corners.min(axis=0)])

    def warped(layer: NDArray[Any], flags: int, border: int, beyond: float = 0.0) -> NDArray[Any]:
        return np.asarray(
            cv2.warpAffine(layer, matrix, size.tolist(), flags=flags, borderMode=border, borderValue=beyond)
        )

    mask = warped(a.mask.astype(np.uint8), cv2.INTER_NEAREST, cv2.BORDER_CONSTANT) > 0
    rgb = warped(a.rgb, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE)
    if a.height is None:
        return Raster(rgb, mask)
    return Raster(rgb, mask, warped(a.height, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT, float("nan")))
