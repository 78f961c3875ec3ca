# SPDX-License-Identifier: Apache-2.0
"""Matches, and the registration that is solved from them, with the criteria that decide about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skymoor.geometry import Similarity
from skymoor.types.arrays import Array, Mask


@dataclass(frozen=True, eq=False)
class Matches2D:
    """Pairs of pixels (n, 2) with confidence (n,)."""

    px_a: Array
    px_b: Array
    confidence: Array

    def __len__(self) -> int:
        return len(self.px_a)

    def take(self, index: NDArray[np.intp] | Mask) -> Matches2D:
        """Keep some of the matches."""
        return Matches2D(self.px_a[index], self.px_b[index], self.confidence[index])


@dataclass(frozen=True, eq=False)
class Matches3D:
    """Pairs of points (n, 3): in the model's level frame and in ENU metres; with the pixels they came from."""

    xyz_level: Array
    xyz_enu: Array
    pixels: Matches2D

    def __len__(self) -> int:
        return len(self.xyz_level)

    def take(self, index: NDArray[np.intp] | Mask) -> Matches3D:
        """Keep some of the matches."""
        return Matches3D(self.xyz_level[index], self.xyz_enu[index], self.pixels.take(index))

    @classmethod
    def joined(cls, parts: Sequence[Matches3D]) -> Matches3D:
        """All matches of all parts; their pixels are each part's own."""
        none = np.zeros((0, 3))
        pixels = Matches2D(
            np.concatenate([none[:, :2], *(part.pixels.px_a for part in parts)]),
            np.concatenate([none[:, :2], *(part.pixels.px_b for part in parts)]),
            np.concatenate([none[:, 0], *(part.pixels.confidence for part in parts)]),
        )
        xyz_level = np.concatenate([none, *(part.xyz_level for part in parts)])
        return cls(xyz_level, np.concatenate([none, *(part.xyz_enu for part in parts)]), pixels)


@dataclass(frozen=True)
class Criterion:
    """A value that was compared with a limit to decide about a registration.

    `kind` is a key of `registration.criterion_kinds.KINDS`, which says what it means, on which side of the limit it
    passes, and what helps where it fails.
    """

    kind: str
    value: float
    limit: float
    passed: bool


HeightStatus = Literal["CONFIRMED", "OFFSET_ONLY", "NOT_CONFIRMED"]


@dataclass(frozen=True)
class HeightVerdict:
    """What the reference says of a model's heights, apart from its position on the map.

    CONFIRMED: its relief is the model's. OFFSET_ONLY: heights hang on the reference's mean height alone. NOT_CONFIRMED:
    the reference has no heights, or such that contradict the photos; the model's heights are relative then.

    Attributes:
        status: one of these.
        reason: why it is not more; also what else is to be known.
        scale, scale_sigma: the reference's relief divided by the model's, and its standard deviation.
        spread_m: robust standard deviation of the difference of both.
        resolution_m: finest detail of the elevation model, estimated.
    """

    status: HeightStatus
    reason: str = ""
    scale: float | None = None
    scale_sigma: float | None = None
    spread_m: float | None = None
    resolution_m: float | None = None


@dataclass(frozen=True, eq=False)
class Registration:
    """Where a model is on Earth, or why that is not known.

    `criteria` are all that were checked, in the order in which they take precedence; `reason` is that of the first that
    failed. A refusal before any was checked has a reason and no criteria.
    """

    registered: bool
    reason: str
    enu_from_level: Similarity | None
    n_matches: int = 0
    n_inliers: int = 0
    tilt_deg: float = float("nan")
    rmse_m: float = float("nan")
    covariance: Array | None = None  # (7, 7) of scale (log), rotation (rad), translation at the inliers' centroid (m)
    centroid_enu: Array | None = None
    inliers: Mask | None = None
    residuals_m: Array | None = None  # (n, 3) east-north-up of every match
    diagnostics: dict[str, float] = field(default_factory=dict)
    criteria: tuple[Criterion, ...] = ()
    heights: HeightVerdict | None = None  # of models that are registered on the map
    absolute: Array | None = None  # (8, 8) after control: of the same and of the log focal length, without a reference
    lean: tuple[float, float] | None = None  # of raised surfaces in the orthophoto, metres east and north per metre up

    @property
    def inlier_ratio(self) -> float:
        """Share of the matches that the transform explains."""
        return self.n_inliers / self.n_matches if self.n_matches else 0.0
