# SPDX-License-Identifier: Apache-2.0
"""How well images fit that cannot be right: what chance reaches in this reference, with an image like this one.

A mirrored image has all that the true one has, edges, textures and heights, and lies nowhere; nor does one whose
parts have been mixed up. They are searched as the true one was, over the same headings, scales and places.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skymoor.engines.options import FIXED
from skymoor.match.search import SearchOptions, Sized, search_in
from skymoor.types import Progress, Raster, no_progress

FEWEST = 2
SEAM_PX = 2  # around parts that have been put elsewhere, where nothing is known


@dataclass(frozen=True)
class DecoyOptions:
    """How chance is asked.

    Attributes:
        count: of decoys at most: the mirrored image, then mixed ones, every second of them mirrored as well.
        parts: along each side, into which an image is cut.
        keep: places of each that are refined.
    """

    count: int = 4
    parts: int = field(default=4, metadata=FIXED)
    keep: int = field(default=4, metadata=FIXED)


def decoy_scores(
    a: Raster,
    b: Raster,
    *,
    min_scale: float,
    max_scale: float,
    options: SearchOptions | None = None,
    decoys: DecoyOptions | None = None,
    rng: np.random.Generator,
    enough: Callable[[Sequence[float]], bool] = lambda _: False,
    progress: Progress = no_progress,
) -> list[float]:
    """The best score of each decoy of `a` in `b`, to be compared with those of `search_hypotheses`.

    Arguments are those of `search_hypotheses`; `rng` mixes the parts. From the second decoy on `enough` is asked
    whether those so far say all there is to say: each costs as much as the search.
    """
    decoys = decoys or DecoyOptions()
    options = replace(options or SearchOptions(), keep=decoys.keep)
    reference, scores = Sized(b), []
    for decoy in made_decoys(a, decoys, rng):
        found = search_in(
            reference, decoy, min_scale=min_scale, max_scale=max_scale, options=options, progress=no_progress
        )
        scores += [found[0].score] if found else []
        if len(scores) >= FEWEST and enough(scores):
            break
        progress(len(scores), decoys.count)
    progress(decoys.count, decoys.count)
    return scores


def made_decoys(a: Raster, options: DecoyOptions, rng: np.random.Generator) -> Iterator[Raster]:
    """Images that lie nowhere."""
    for k in range(options.count):
        decoy = mirrored(a) if k % 2 == 0 else a
        yield mixed(decoy, options.parts, rng) if k else decoy


def mirrored(a: Raster) -> Raster:
    """Left for right."""
    height = None if a.height is None else np.ascontiguousarray(a.height[:, ::-1])
    return Raster(np.ascontiguousarray(a.rgb[:, ::-1]), np.ascontiguousarray(a.mask[:, ::-1]), height)


def mixed(a: Raster, parts: int, rng: np.random.Generator) -> Raster:
    """Cut into parts, none of which stays where it was; what is left at the far sides is not known any more."""
    rows, columns = (side // parts for side in a.mask.shape)
    order = rng.permutation(parts**2)
    while parts > 1 and (order == np.arange(parts**2)).any():
        order = rng.permutation(parts**2)
    rgb, mask = np.zeros_like(a.rgb), np.zeros_like(a.mask)
    height = None if a.height is None else np.full_like(a.height, np.nan)
    for to, of in enumerate(order):
        (top, left), (from_top, from_left) = divmod(to, parts), divmod(int(of), parts)
        there = np.s_[top * rows : (top + 1) * rows, left * columns : (left + 1) * columns]
        here = np.s_[from_top * rows : (from_top + 1) * rows, from_left * columns : (from_left + 1) * columns]
        inner = np.s_[
            top * rows + SEAM_PX : (top + 1) * rows - SEAM_PX, left * columns + SEAM_PX : (left + 1) * columns - SEAM_PX
        ]
        rgb[there] = a.rgb[here]
        mask[inner] = a.mask[here][SEAM_PX : rows - SEAM_PX, SEAM_PX : columns - SEAM_PX]
        if height is not None and a.height is not None:
            height[there] = a.height[here]
    if height is not None:
        height[~mask] = np.nan
    return Raster(rgb, mask, height)
