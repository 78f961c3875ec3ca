# SPDX-License-Identifier: Apache-2.0
"""Control as observations of a registered model: what it says of eight parameters, linearised, with all covariances.

The parameters are log scale, rotation (radians) and translation (metres) of a correction in ENU about a centre, as of
`refine_similarity`, and the logarithm of the focal length, with which cameras are farther from what they show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from skymoor.control.given import Control, Place, ScaleBar
from skymoor.control.triangulate import triangulate
from skymoor.geo import EnuFrame
from skymoor.geometry import Similarity, moved_similarity, similarity_jacobian
from skymoor.types import Array, Camera

Kind = Literal["point", "position", "scale bar"]
PARAMETERS = 8


@dataclass(frozen=True, eq=False)
class PosedCameras:
    """Cameras of a registered component, ENU metres, with what is known of their errors within the model.

    Attributes:
        cameras: n of them.
        shape: covariances (n, 3, 3) m^2 of their centres within the model; None where they are not known.
        away: (n, 3) metres from what each looks at to its centre: by so much it moves with the focal length.
    """

    cameras: tuple[Camera, ...]
    shape: Array | None
    away: Array


@dataclass(frozen=True, eq=False)
class Located:
    """A point or camera of the model: position (3,) ENU by the registration, its covariance (3, 3) within the model.

    `away` (3,) is by how much it moves with the logarithm of the focal length. One with a `reason` has no position.
    """

    name: str
    kind: Kind
    xyz: Array
    covariance: Array
    away: Array
    n_photos: int
    place: Place | None
    reason: str = ""


def locate(control: Control, posed: PosedCameras, centre: Array) -> list[Located]:
    """Every point and known position of which the component has a photo.

    A wrong focal length stretches the model along the vertical: a point moves by its height above `centre` (3,).
    """
    cameras = {camera.image: camera for camera in posed.cameras}
    found = []
    for point in control.points:
        if not any(mark.image in cameras for mark in point.marks):
            continue
        seen = triangulate(point.marks, cameras)
        away = (seen.xyz - centre) * [0.0, 0.0, 1.0] if posed.away.any() else np.zeros(3)
        found.append(
            Located(point.name, "point", seen.xyz, seen.covariance, away, seen.n_photos, point.place, seen.reason)
        )
    index = {camera.image: k for k, camera in enumerate(posed.cameras)}
    for one in control.positions:
        k = index.get(one.image)
        if k is not None:
            shape = np.zeros((3, 3)) if posed.shape is None else posed.shape[k]
            centre_enu = posed.cameras[k].centre
            found.append(Located(one.image, "position", centre_enu, shape, posed.away[k], 1, one.place))
    return found


@dataclass(frozen=True, eq=False)
class Linear:
    """Observations at some correction: known minus model (m,), its derivative (m, 8), its covariance (m, m).

    The covariance is of control and of the model's own points, not of the registration. `rows` are those of each block.
    """

    misclosure: Array
    design: Array
    errors: Array
    rows: tuple[slice, ...]

    def of(self, kept: Sequence[int]) -> Linear:
        """Those blocks alone."""
        index = np.concatenate([np.arange(len(self.misclosure))[self.rows[k]] for k in kept])
        rows, start = [], 0
        for k in kept:
            size = self.rows[k].stop - self.rows[k].start
            rows.append(slice(start, start + size))
            start += size
        errors = self.errors[np.ix_(index, index)]
        return Linear(self.misclosure[index], self.design[index], errors, tuple(rows))


@dataclass(frozen=True, eq=False)
class Observations:
    """All control of one component: a block of rows for each surveyed position (2 or 3) and each scale bar (1)."""

    places: tuple[Located, ...]
    bars: tuple[ScaleBar, ...]
    ends: Mapping[str, Located]
    frame: EnuFrame
    centre: Array

    @classmethod
    def of(cls, located: Sequence[Located], bars: Sequence[ScaleBar], frame: EnuFrame, centre: Array) -> Observations:
        """What can be used of it: positions that are known on both sides, and bars with both ends."""
        usable = [one for one in located if not one.reason]
        ends = {one.name: one for one in usable if one.kind == "point"}
        kept = tuple(bar for bar in bars if bar.a in ends and bar.b in ends)
        return cls(tuple(one for one in usable if one.place is not None), kept, ends, frame, centre)

    def __len__(self) -> int:
        return len(self.places) + len(self.bars)

    @property
    def names(self) -> list[str]:
        """Of the blocks."""
        return [*(one.name for one in self.places), *(bar.name for bar in self.bars)]

    def at(self, correction: Array | None = None) -> Linear:
        """Linearised at a correction (8,); none for the registration itself."""
        step = np.zeros(PARAMETERS) if correction is None else correction
        points = list({id(one): one for one in (*self.places, *self.ends.values())}.values())
        number = {id(one): k for k, one in enumerate(points)}
        moved = moved_similarity(Similarity.identity(), step[:7], self.centre)
        xyz = moved.apply(np.array([one.xyz for one in points]).reshape(-1, 3))
        away = np.array([one.away for one in points]).reshape(-1, 3)
        jacobian = similarity_jacobian(xyz - self.centre - step[4:7])
        design = np.concatenate([jacobian, away[:, :, None]], axis=2)
        xyz = xyz + step[7] * away
        misclosure: list[Array] = []
        own: list[float] = []
        picks: list[list[tuple[int, Array]]] = []
        for one in self.places:
            known, variances = _known(one, self.frame, xyz[number[id(one)]])
            misclosure.append(known - xyz[number[id(one)]][: len(known)])
            own += variances.tolist()
            picks.append([(number[id(one)], np.eye(3)[: len(known)])])
        for bar in self.bars:
            a, b = number[id(self.ends[bar.a])], number[id(self.ends[bar.b])]
            gap = xyz[a] - xyz[b]
            length = float(np.linalg.norm(gap))
            along = (gap / length)[None]
            picks.append([(a, along), (b, -along)])
            misclosure.append(np.array([bar.length_m - length]))
            own.append(bar.sigma_m**2)
        return _assembled(picks, misclosure, own, design, np.array([one.covariance for one in points]))


def _assembled(
    picks: Sequence[Sequence[tuple[int, Array]]],
    misclosure: Sequence[Array],
    own: Sequence[float],
    design: Array,
    covariances: Array,
) -> Linear:
    """Observations that are linear in the model's points: `picks` are, for each block, points and their factors.

    A point that is surveyed and also the end of a bar has one error in both, so that they are correlated.
    """
    sizes = [len(one) for one in misclosure]
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    rows = tuple(slice(int(a), int(b)) for a, b in pairwise(starts))
    factors = np.zeros((int(starts[-1]), 3 * len(design)))
    for block, parts in zip(rows, picks, strict=True):
        for k, factor in parts:
            factors[block, 3 * k : 3 * k + 3] += factor
    spread = np.zeros((3 * len(design), 3 * len(design)))
    for k, covariance in enumerate(covariances):
        spread[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = covariance
    errors = factors @ spread @ factors.T + np.diag(own)
    return Linear(np.concatenate(misclosure), factors @ design.reshape(-1, PARAMETERS), errors, rows)


def _known(one: Located, frame: EnuFrame, near: Array) -> tuple[Array, Array]:
    """East, north and, where it is known, up of a surveyed position, and their variances.

    Without a height the plan position is taken at the height of the model, `near` (3,).
    """
    place = one.place
    assert place is not None
    in_plan = np.isnan(place.height)
    height = float(frame.lla_from_enu(near)[0, 2]) if in_plan else place.height
    enu = frame.enu_from_lla(place.lat, place.lon, height)[0]
    variances = np.array([place.sigma_h**2, place.sigma_h**2, place.sigma_v**2])
    size = 2 if in_plan else 3
    return enu[:size], variances[:size]
