# SPDX-License-Identifier: Apache-2.0
"""Where the cameras are: as a table, as GeoJSON, and the transform that put them there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import ArrayLike

from skymoor.geo import EnuFrame
from skymoor.geometry import Similarity
from skymoor.results.tables import CameraRow
from skymoor.types import Camera, HeightStatus


def placed_cameras(
    set_name: str,
    component: int,
    cameras_enu: Sequence[Camera],
    frame: EnuFrame,
    accuracy_m: ArrayLike,
    heights: HeightStatus | None = None,
) -> list[CameraRow]:
    """Rows of a registered component, whose cameras are in ENU.

    `accuracy_m` (4,), or (n, 4) for n cameras, is CE90 and LE90, and both without the error of the reference; NaN where
    that is unknown. Where `heights` are not confirmed, none is written: a number would be used.
    """
    if not cameras_enu:
        return []
    enu = np.array([camera.centre for camera in cameras_enu])
    lla = frame.lla_from_enu(enu)
    quaternions = np.array([camera.cam_from_world.quaternion_wxyz for camera in cameras_enu])
    accuracy = np.broadcast_to(np.asarray(accuracy_m, float), (len(enu), 4))
    poses = np.hstack([lla, enu, quaternions]).tolist()
    known = [[None if np.isnan(value) else value for value in row] for row in accuracy.tolist()]
    rows = [
        replace(CameraRow(camera.image, set_name, component, "REGISTERED", *pose, *figures), heights=heights)
        for camera, pose, figures in zip(cameras_enu, poses, known, strict=True)
    ]
    if heights == "NOT_CONFIRMED":
        return [replace(row, height=None, le90=None, relative_le90=None) for row in rows]
    return rows


def unplaced_cameras(set_name: str, component: int | None, images: Iterable[str]) -> list[CameraRow]:
    """Rows of a component that is not registered, or (None) of images that no reconstruction took."""
    return [CameraRow(image, set_name, component, "NOT_REGISTERED") for image in images]


def cameras_table(rows: Iterable[CameraRow]) -> list[dict[str, object]]:
    """Rows as dictionaries with the keys `results.tables.CAMERA_COLUMNS`, for a csv writer."""
    return [asdict(row) for row in rows]


def cameras_geojson(rows: Iterable[CameraRow]) -> dict[str, object]:
    """A FeatureCollection (RFC 7946): points of longitude, latitude, ellipsoidal height; null geometry if unplaced."""
    features = []
    for row in rows:
        properties = {name: value for name, value in asdict(row).items() if name not in ("lat", "lon", "height")}
        position = [row.lon, row.lat] if row.height is None else [row.lon, row.lat, row.height]
        point = None if row.lat is None else {"type": "Point", "coordinates": position}
        features.append({"type": "Feature", "geometry": point, "properties": properties})
    return {"type": "FeatureCollection", "features": features}


def georeference(frame: EnuFrame, enu_from_sfm: Similarity, heights: HeightStatus | None = None) -> dict[str, object]:
    """What goes beside a model in ENU metres: origin on Earth, the transform that was applied, verdict on heights.

    Where heights are not confirmed, up is relative: to the model's own ground, or to a reference that contradicts it.
    """
    verdict = {} if heights is None else {"heights": heights}
    return verdict | {
        "frame": "east-north-up metres, WGS 84 ellipsoid",
        "enu_origin": {"lat": frame.lat_deg, "lon": frame.lon_deg, "height": frame.height_m},
        "enu_from_sfm": {
            "scale": enu_from_sfm.scale,
            "quaternion_wxyz": enu_from_sfm.quaternion_wxyz.tolist(),
            "translation_m": enu_from_sfm.translation.tolist(),
        },
    }
