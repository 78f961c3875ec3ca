# SPDX-License-Identifier: Apache-2.0
"""A place of an image in a reference, with its azimuth and scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skymoor.types import Array


@dataclass(frozen=True)
class ImageHypothesis:
    """A similarity: pixel p of the image is at `scale * R (p - centre) + centre_px` of the reference, in pixels.

    R rotates by `azimuth_rad` from u towards v; `centre` is the middle of the image and `centre_px` its position
    (u, v) in the reference. `score` is the correlation in standard deviations of unrelated content; scores are
    comparable within one level of refinement only. `by_features`: local features were decisive, and nothing else was
    searched.
    """

    scale: float
    azimuth_rad: float
    centre_px: tuple[float, float]
    score: float
    by_features: bool = False

    def matrix(self, shape: tuple[int, int]) -> Array:
        """(2, 3) affine from the pixels of an image of `shape` (h, w) to those of the reference."""
        c, s = self.scale * np.cos(self.azimuth_rad), self.scale * np.sin(self.azimuth_rad)
        linear = np.array([[c, -s], [s, c]])
        centre = np.array([shape[1] / 2, shape[0] / 2])
        return np.column_stack([linear, np.array(self.centre_px) - linear @ centre])


def distinct(
    hypotheses: list[ImageHypothesis], shape: tuple[int, int], most: int | None = None
) -> list[ImageHypothesis]:
    """The best first, at most `most`, without near duplicates of a better one; `shape` (h, w) is the image's."""
    kept: list[ImageHypothesis] = []
    for p in sorted(hypotheses, key=lambda p: -p.score):
        if len(kept) == most:
            break
        if all(not equivalent(p, q, shape) for q in kept):
            kept.append(p)
    return kept


def equivalent(p: ImageHypothesis, q: ImageHypothesis, shape: tuple[int, int]) -> bool:
    """Whether two hypotheses differ by no more than a refinement would correct."""
    rotation = abs((p.azimuth_rad - q.azimuth_rad + np.pi) % (2 * np.pi) - np.pi)
    distance = np.hypot(p.centre_px[0] - q.centre_px[0], p.centre_px[1] - q.centre_px[1])
    near = 0.12 * max(shape) * max(p.scale, q.scale)
    return bool(rotation < np.radians(15) and abs(np.log(p.scale / q.scale)) < 0.2 and distance < near)
