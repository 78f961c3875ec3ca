# SPDX-License-Identifier: Apache-2.0
"""Text that OpenDroneMap reads: where the cameras are and look, and ground control with its pixels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.geometry import Similarity
from skymoor.results.tables import CameraRow
from skymoor.types import Array, Component

HEADER = "EPSG:4326"
MIN_TRACK = 3
MARKS_PER_POINT = 6
NED_FROM_ENU = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
# Axes of an aircraft whose camera looks down: forward is the upper edge of the image, right its right, down the view.
CAM_FROM_BODY = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])


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
            angles = yaw_pitch_roll_deg(row)
            if angles is not None:
                yaw, pitch, roll = angles
                line += f" {yaw:.4f} {pitch:.4f} {roll:.4f} {row.ce90 or 0:.4f} {row.le90 or 0:.4f}"
        lines.append(line)
    return "\n".join([HEADER, *lines]) + "\n"


def yaw_pitch_roll_deg(row: CameraRow) -> tuple[float, float, float] | None:
    """Angles of a camera as ODM counts them, degrees; None where its rotation is not known.

    ODM turns north-east-down axes by yaw, pitch and roll, in this order and about the turned axes, into those of an
    aircraft whose camera looks down with the upper edge of the image forward. So all angles are 0 for a camera that
    looks straight down with north at the top; yaw is the direction of the upper edge, clockwise; pitch 90 looks at the
    horizon in that direction; a positive roll lifts the left side. ODM adds 90 to the gimbal pitch of some makers'
    photos for this, but takes geo.txt as it is (opendm/photo.py, opendm/geo.py; issue 1473 and pull request 1546 of
    OpenDroneMap/ODM).
    """
    quaternion = (row.qw, row.qx, row.qy, row.qz)
    if any(value is None for value in quaternion):
        return None
    cam_from_enu = Similarity.from_quaternion_wxyz(1.0, np.array(quaternion, float), np.zeros(3)).rotation
    ned_from_body = NED_FROM_ENU @ cam_from_enu.T @ CAM_FROM_BODY
    yaw = np.arctan2(ned_from_body[1, 0], ned_from_body[0, 0])
    pitch = np.arcsin(np.clip(-ned_from_body[2, 0], -1, 1))
    roll = np.arctan2(ned_from_body[2, 1], ned_from_body[2, 2])
    degrees: Array = np.degrees([yaw, pitch, roll])
    return float(degrees[0]), float(degrees[1]), float(degrees[2])


def odm_names(images: Iterable[str]) -> dict[str, str]:
    """How ODM's lists call each image: ODM has one folder of images and knows them by their bare names.

    Of images of one name in several folders, that of the folder goes before it. Raises `InputError` for a name with
    spaces, which those lists cannot contain.
    """
    ordered = list(images)
    bare = Counter(PurePosixPath(image).name for image in ordered)
    with_folder = Counter("_".join(PurePosixPath(image).parts[-2:]) for image in ordered)
    names = {}
    for image in ordered:
        path = PurePosixPath(image)
        name = path.name if bare[path.name] == 1 else "_".join(path.parts[-2:])
        names[image] = name if bare[path.name] == 1 or with_folder[name] == 1 else "_".join(path.parts)
        if any(letter.isspace() for letter in names[image]):
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
