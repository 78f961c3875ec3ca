# SPDX-License-Identifier: Apache-2.0
"""Surveyed points and camera positions of a simulated flight whose registration is off by a known error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skymoor.control import Control, ControlPoint, KnownPosition, Mark, Place, PosedCameras, Prior, ScaleBar
from skymoor.geo import EnuFrame
from skymoor.geometry import Similarity, moved_similarity
from skymoor.types import Camera
from support.blocks import ring, strips

Array = NDArray[np.float64]

FRAME = EnuFrame(47.0, 8.0, 400.0)
CENTRE = np.array([3.0, -2.0, 1.0])
SIGMAS = np.array([0.002, 0.001, 0.001, 0.002, 0.8, 0.8, 1.5])
"""Of a registration: log scale, radians, metres with the reference's own error."""
PRIOR = Prior(np.diag(np.append(SIGMAS, 0.0) ** 2), CENTRE)
SIX = np.array([[-30, -20, 0], [28, -22, 2], [25, 24, 5], [-27, 21, 1], [0, 3, 4], [12, -8, 0]], float)
SURVEY_M = np.array([0.02, 0.02, 0.03])


def flown() -> list[Camera]:
    """20 cameras where they truly are, ENU metres."""
    return [*ring(14), *strips()[::2]]


def place(enu: Array, sigma: Array = SURVEY_M, where: str = "gcp.txt, line 2") -> Place:
    """A surveyed position; a height that is NaN is not known."""
    lat, lon, height = FRAME.lla_from_enu(np.nan_to_num(enu))[0].tolist()
    return Place(lat, lon, height if np.isfinite(enu[2]) else float("nan"), sigma[0], sigma[2], where)


def marked(name: str, xyz: Array, cameras: Sequence[Camera], rng: np.random.Generator | None) -> tuple[Mark, ...]:
    """Its pixels in all cameras that see it, off by a pixel where there is a generator."""
    marks = []
    for camera in cameras:
        i = camera.intrinsics
        px = i.px_from_cam(camera.cam_from_world.apply(xyz[None]))[0]
        px = px if rng is None else px + rng.normal(size=2)
        if np.isfinite(px).all() and (px >= 0).all() and px[0] <= i.width and px[1] <= i.height:
            marks.append(Mark(camera.image, float(px[0]), float(px[1]), f"{name}, line 2"))
    return tuple(marks)


def surveyed(
    xyz: Array = SIX,
    *,
    rng: np.random.Generator | None = None,
    off: dict[int, Array] | None = None,
    use: bool = False,
    positions: Sequence[int] = (),
    bars: Sequence[tuple[int, int, float]] = (),
) -> Control:
    """Points `P0` and so on; `off` are blunders in metres by their number, bars have factors on the true length."""
    cameras, points = flown(), []
    for k, one in enumerate(xyz):
        error = np.zeros(3) if rng is None else rng.normal(size=3) * SURVEY_M
        error = error + (off or {}).get(k, np.zeros(3))
        points.append(ControlPoint(f"P{k}", marked(f"P{k}", one, cameras, rng), place(one + error)))
    known = []
    for k in positions:
        error = np.zeros(3) if rng is None else rng.normal(size=3) * SURVEY_M
        known.append(KnownPosition(cameras[k].image, place(cameras[k].centre + error)))
    lengths = [(a, b, factor * float(np.linalg.norm(xyz[a] - xyz[b]))) for a, b, factor in bars]
    rods = [ScaleBar(f"P{a}", f"P{b}", length, 0.01, "bars.csv, line 2") for a, b, length in lengths]
    return Control(tuple(points), tuple(known), tuple(rods), use)


def registered(error: Array) -> PosedCameras:
    """The cameras as a registration has them that must be corrected by `error` (7,) about `CENTRE`."""
    wrong = moved_similarity(Similarity.identity(), error, CENTRE).inverse()
    cameras = tuple(camera.transformed(wrong) for camera in flown())
    return PosedCameras(cameras, None, np.zeros((len(cameras), 3)))


def without_places(control: Control) -> Control:
    """The same points, which only scale bars use."""
    return replace(control, points=tuple(replace(one, place=None) for one in control.points))
