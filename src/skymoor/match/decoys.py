# SPDX-License-Identifier: Apache-2.0
"""Null distribution of the search score, from decoys of the render in the same reference.

A decoy is a mirrored or block-shuffled copy of the render: it keeps edges, textures and heights, but matches nowhere.
Decoys are searched like the render, over the same rotations, scales and positions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from skymoor.engines.options import FIXED
from skymoor.match.features import Features
from skymoor.match.hypothesis import ImageHypothesis
from skymoor.match.propose import ALL_AZIMUTHS
from skymoor.match.search import ReferencePyramid, SearchOptions, search_in
from skymoor.types import Progress, Raster, no_progress

MIN_DECOYS = 2
SEAM_PX = 2  # masked border around each shuffled block


@dataclass(frozen=True)
class DecoyOptions:
    """Number and making of decoys.

    Attributes:
        count: largest number of decoys: the mirrored image, then shuffled ones, every second of them also mirrored.
        parts: blocks along each side of a shuffled image.
        keep: hypotheses refined per decoy.
    """

    count: int = 4
    parts: int = field(default=4, metadata=FIXED)
    keep: int = field(default=4, metadata=FIXED)


def search_decoys(
    a: Raster,
    b: Raster,
    *,
    min_scale: float,
    max_scale: float,
    options: SearchOptions | None = None,
    decoys: DecoyOptions | None = None,
    rng: np.random.Generator,
    azimuths: tuple[float, float] = ALL_AZIMUTHS,
    features: Features | None = None,
    by_features: bool | None = None,
    enough: Callable[[Sequence[float]], bool] = lambda _: False,
    progress: Progress = no_progress,
) -> list[tuple[Raster, ImageHypothesis]]:
    """Decoys of `a` with their best hypotheses in `b`: null samples for those of `search_hypotheses`.

    Arguments are those of `search_hypotheses`; `by_features` says how that found what they are compared with; `rng`
    shuffles the blocks. From the second decoy on, the loop stops
    early once `enough(scores)` is true: each decoy costs as much as the search.
    """
    decoys = decoys or DecoyOptions()
    options = replace(options or SearchOptions(), keep=decoys.keep)
    reference = ReferencePyramid(b, features)
    best: list[tuple[Raster, ImageHypothesis]] = []
    for decoy in make_decoys(a, decoys, rng):
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


def make_decoys(a: Raster, options: DecoyOptions, rng: np.random.Generator) -> Iterator[Raster]:
    """Up to `options.count` decoys of `a`, with masks and heights."""
    for k in range(options.count):
        decoy = mirrored(a) if k % 2 == 0 else a
        yield mixed(decoy, options.parts, rng) if k else decoy


def mirrored(a: Raster) -> Raster:
    """`a` flipped left to right."""
    height = None if a.height is None else np.ascontiguousarray(a.height[:, ::-1])
    return Raster(np.ascontiguousarray(a.rgb[:, ::-1]), np.ascontiguousarray(a.mask[:, ::-1]), height)


def mixed(a: Raster, parts: int, rng: np.random.Generator) -> Raster:
    """`a` cut into `parts` x `parts` blocks, none of which keeps its position; leftover rows and columns are masked."""
    rows, columns = (side // parts for side in a.mask.shape)
    order = rng.permutation(parts**2)
    while parts > 1 and (order == np.arange(parts**2)).any():
        order = rng.permutation(parts**2)
    rgb, mask = np.zeros_like(a.rgb), np.zeros_like(a.mask)
    height = None if a.height is None else np.full_like(a.height, np.nan)
    for target, source in enumerate(order):
        (top, left), (source_top, source_left) = divmod(target, parts), divmod(int(source), parts)
        destination = np.s_[top * rows : (top + 1) * rows, left * columns : (left + 1) * columns]
        block = np.s_[source_top * rows : (source_top + 1) * rows, source_left * columns : (source_left + 1) * columns]
        inner = np.s_[
            top * rows + SEAM_PX : (top + 1) * rows - SEAM_PX, left * columns + SEAM_PX : (left + 1) * columns - SEAM_PX
        ]
        rgb[destination] = a.rgb[block]
        mask[inner] = a.mask[block][SEAM_PX : rows - SEAM_PX, SEAM_PX : columns - SEAM_PX]
        if height is not None and a.height is not None:
            height[destination] = a.height[block]
    if height is not None:
        height[~mask] = np.nan
    return Raster(rgb, mask, height)
