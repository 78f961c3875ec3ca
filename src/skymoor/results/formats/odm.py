# SPDX-License-Identifier: Apache-2.0
"""Text that OpenDroneMap reads: where the cameras are, and ground control with its pixels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.results.tables import CameraRow
from skymoor.types import Component

HEADER = "EPSG:4326"
MIN_TRACK = 3
MARKS_PER_POINT = 6


def odm_geo(rows: Sequence[CameraRow]) -> str:
    """geo.txt: image, longitude, latitude, ellipsoidal height, three angles (0: not used), CE90 and LE90 in metres.

    Nothing follows the latitude where heights are not confirmed.
    """
    lines = [
        f"{_name(row.image)} {row.lon:.10f} {row.lat:.10f}"
        + ("" if row.height is None else f" {row.height:.4f} 0 0 0 {row.ce90 or 0:.4f} {row.le90 or 0:.4f}")
        for row in rows
    ]
    return "\n".join([HEADER, *lines]) + "\n"


def odm_gcp_list(component_enu: Component, frame: EnuFrame, label: str, count: int = 20) -> str:
    """Lines (without the header) of longitude, latitude, ellipsoidal height, pixel, image and label of check points.

    They are points of the model that three or more photos see, spread over its plan: each is the farthest from those
    before it. ODM counts pixels from the centre of the first one, which is (0, 0) there.
    """
    seen = np.bincount(component_enu.obs_point, minlength=len(component_enu.points))
    candidates = np.flatnonzero(seen >= MIN_TRACK)
    if not len(candidates):
        return ""
    plan = component_enu.points[candidates, :2]
    gap = np.linalg.norm(plan - np.median(plan, axis=0), axis=1)
    chosen = [int(np.argmin(gap))]
    gap = np.linalg.norm(plan - plan[chosen[0]], axis=1)
    while len(chosen) < min(count, len(candidates)) and gap.max() > 0:
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(plan - plan[chosen[-1]], axis=1))
    lines = []
    for k, point in enumerate(candidates[chosen]):
        lat, lon, height = frame.lla_from_enu(component_enu.points[point])[0]
        for j in np.flatnonzero(component_enu.obs_point == point)[:MARKS_PER_POINT]:
            u, v = component_enu.obs_px[j] - 0.5
            image = _name(component_enu.cameras[component_enu.obs_camera[j]].image)
            lines.append(f"{lon:.10f} {lat:.10f} {height:.4f} {u:.3f} {v:.3f} {image} {label}_{k}\n")
    return "".join(lines)


def _name(image: str) -> str:
    name = image.rpartition("/")[2]
    if any(letter.isspace() for letter in name):
        raise InputError(f"{image}: ODM's lists part words by spaces; rename the photo without them, and run again")
    return name
