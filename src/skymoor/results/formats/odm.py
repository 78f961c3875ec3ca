# SPDX-License-Identifier: Apache-2.0
"""Text that OpenDroneMap reads: where the cameras are and look, and ground control with its pixels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.results.formats.angles import rotation_of, yaw_pitch_roll_deg
from skymoor.results.formats.names import bare_names
from skymoor.results.tables import CameraRow
from skymoor.types import Array, Component

HEADER = "EPSG:4326"
MIN_TRACK = 3
MARKS_PER_POINT = 6


def odm_geo(rows: Sequence[CameraRow], names: Mapping[str, str] | None = None) -> str:
    """geo.txt: image, longitude, latitude, ellipsoidal height, yaw, pitch, roll, and CE90 and LE90 in metres.

    Nothing follows the latitude where heights are not confirmed, nor the height where the rotation is not known: zeros
    would say that the camera looks straight down. `names` are those of `odm_names`.
    """
    names = odm_names(row.image for row in rows) if names is None else names
    lines = []
    for row in rows:
        line = f"{names[row.image]} {row.lon:.10f} {row.lat:.10f}"
        if row.height is not None:
            line += f" {row.height:.4f}"
            rotation = rotation_of(row)
            if rotation is not None:
                yaw, pitch, roll = yaw_pitch_roll_deg(rotation)
                line += f" {yaw:.4f} {pitch:.4f} {roll:.4f} {row.ce90 or 0:.4f} {row.le90 or 0:.4f}"
        lines.append(line)
    return "\n".join([HEADER, *lines]) + "\n"


def odm_names(images: Iterable[str]) -> dict[str, str]:
    """How ODM's lists call each image: ODM has one folder of images and knows them by their bare names.

    They are those of `bare_names`. Raises `InputError` for a name with
    spaces, which those lists cannot contain.
    """
    names = bare_names(images)
    for image, name in names.items():
        if any(letter.isspace() for letter in name):
            raise InputError(f"{image}: ODM's lists part words by spaces; rename the photo without them, and run again")
    return names


def odm_gcp_list(
    component_enu: Component,
    frame: EnuFrame,
    label: str,
    names: Mapping[str, str] | None = None,
    count: int = 20,
) -> str:
    """Lines (without the header) of longitude, latitude, ellipsoidal height, pixel, image and label of check points.

    They are points of the model that three or more photos see, spread over its plan: each is the farthest from those
    before it. ODM counts pixels from the centre of the first one, which is (0, 0) there.
    """
    names = odm_names(camera.image for camera in component_enu.cameras) if names is None else names
    marks = _one_mark_per_photo(component_enu)
    seen = np.bincount(component_enu.obs_point[marks], minlength=len(component_enu.points))
    candidates = np.flatnonzero(seen >= MIN_TRACK)
    if not len(candidates):
        return ""
    lines = []
    for k, point in enumerate(candidates[_spread(component_enu.points[candidates, :2], count)]):
        lat, lon, height = frame.lla_from_enu(component_enu.points[point])[0]
        for j in marks[component_enu.obs_point[marks] == point][:MARKS_PER_POINT]:
            u, v = component_enu.obs_px[j] - 0.5
            image = names[component_enu.cameras[component_enu.obs_camera[j]].image]
            lines.append(f"{lon:.10f} {lat:.10f} {height:.4f} {u:.3f} {v:.3f} {image} {label}_{k}\n")
    return "".join(lines)


def _one_mark_per_photo(component: Component) -> NDArray[np.intp]:
    """Observations, in their order; of a point that two features of a photo are matched to, the one that fits best."""
    errors: Array = np.zeros(len(component.obs_px))
    for k, camera in enumerate(component.cameras):
        own = component.obs_camera == k
        xyz_cam = camera.cam_from_world.apply(component.points[component.obs_point[own]])
        errors[own] = np.linalg.norm(camera.intrinsics.px_from_cam(xyz_cam) - component.obs_px[own], axis=1)
    best_first = np.lexsort((errors, component.obs_camera, component.obs_point))
    pairs = np.stack([component.obs_point[best_first], component.obs_camera[best_first]], axis=1)
    _, first = np.unique(pairs, axis=0, return_index=True)
    return np.sort(best_first[first])


def _spread(plan: Array, count: int) -> list[int]:
    """Rows of `plan` (n, 2): one in the middle, and each the farthest from those before it."""
    gap = np.linalg.norm(plan - np.median(plan, axis=0), axis=1)
    chosen = [int(np.argmin(gap))]
    gap = np.linalg.norm(plan - plan[chosen[0]], axis=1)
    while len(chosen) < min(count, len(plan)) and gap.max() > 0:
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(plan - plan[chosen[-1]], axis=1))
    return chosen
