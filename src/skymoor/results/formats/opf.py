# SPDX-License-Identifier: Apache-2.0
"""Cameras as Pix4D's Open Photogrammetry Format (OPF 1.0): a project of JSON files."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any
from urllib.parse import quote

import numpy as np
from pyproj import CRS
from scipy.spatial.transform import Rotation

from skymoor import __version__
from skymoor.geo import EnuFrame
from skymoor.geo.accuracy import CE90_PER_SIGMA, LE90_PER_SIGMA
from skymoor.geometry import Intrinsics
from skymoor.results.formats._crs import MapFrame
from skymoor.results.tables import CameraRow
from skymoor.types import Array, Camera

FULL_FRAME_UM = 36_000.0
JSON = dict[str, Any]


def opf_project(
    cameras_enu: Sequence[Camera],
    rows: Mapping[str, CameraRow],
    paths: Mapping[str, str],
    times: Sequence[datetime],
    frame: EnuFrame,
    name: str,
) -> dict[str, JSON]:
    """The files of a project by their names, `project.opf` and those that it refers to.

    `paths` gives the file of each image relative to the project, `times` are one a camera. The scene's CRS is a
    transverse Mercator projection around the site's origin, true to scale at its height, with heights above the
    ellipsoid, shifted to the origin's. Angles are omega, phi, kappa of the rotation from right-top-back axes of the
    image; the principal point counts from the corner of the image, as here. OPF knows one focal length: the geometric
    mean of both.
    """
    lenses = {lens: k + 1 for k, lens in enumerate(dict.fromkeys(camera.intrinsics for camera in cameras_enu))}
    numbers = [len(lenses) + 1 + k for k in range(len(cameras_enu))]
    listed = [{"id": k, "uri": quote(paths[one.image])} for k, one in zip(numbers, cameras_enu, strict=True)]
    captures = [
        _capture(k, lenses[one.intrinsics], rows[one.image], time)
        for k, one, time in zip(numbers, cameras_enu, times, strict=True)
    ]
    calibrated = [
        {"id": k, "sensor_id": lenses[one.intrinsics], **pose}
        for k, one, pose in zip(numbers, cameras_enu, _poses(cameras_enu, frame), strict=True)
    ]
    internals = [{"id": k, "internals": _internals(lens)} for lens, k in lenses.items()]
    files = {
        "scene_reference_frame": _scene(frame),
        "camera_list": {"cameras": listed},
        "input_cameras": {"sensors": [_sensor(lens, k) for lens, k in lenses.items()], "captures": captures},
        "calibrated_cameras": {"sensors": internals, "cameras": calibrated},
    }
    formats = {kind: f"application/opf-{kind.replace('_', '-')}+json" for kind in files}
    found = {f"{kind}.json": {"format": formats[kind], "version": "1.0", **content} for kind, content in files.items()}
    return {"project.opf": _project(formats, name, repr((frame, times, sorted(rows)))), **found}


def _project(formats: Mapping[str, str], name: str, key: str) -> JSON:
    """The list of items; their identifiers are derived from `key`, so the same run gives the same project."""
    sources = {
        "scene_reference_frame": (),
        "camera_list": (),
        "input_cameras": ("camera_list",),
        "calibration": ("scene_reference_frame", "input_cameras"),
    }
    ids = {kind: str(uuid.uuid5(uuid.NAMESPACE_URL, f"skymoor {kind} {key}")) for kind in ("project", *sources)}
    items = []
    for kind, needed in sources.items():
        file = "calibrated_cameras" if kind == "calibration" else kind
        resources = [{"uri": f"{file}.json", "format": formats[file]}]
        used = [{"id": ids[one], "type": one} for one in needed]
        items.append({"id": ids[kind], "type": kind, "name": kind, "resources": resources, "sources": used})
    return {
        "format": "application/opf-project+json",
        "version": "1.0",
        "id": ids["project"],
        "name": name,
        "description": "Cameras registered by skymoor",
        "generator": {"name": "skymoor", "version": __version__},
        "items": items,
    }


def _chart(frame: EnuFrame) -> MapFrame:
    """Transverse Mercator whose scale is true at the origin's height: lengths across and up must be the same metres."""
    ellipsoid = CRS.from_epsg(4979).ellipsoid
    assert ellipsoid is not None
    flat = 1 - (ellipsoid.semi_minor_metre / ellipsoid.semi_major_metre) ** 2
    radius = ellipsoid.semi_minor_metre / (1 - flat * np.sin(np.radians(frame.lat_deg)) ** 2)  # Gauss's mean radius
    scale = float(1 + frame.height_m / radius)
    plan = f"+proj=tmerc +lat_0={frame.lat_deg!r} +lon_0={frame.lon_deg!r} +k={scale!r} +datum=WGS84 +units=m +type=crs"
    return MapFrame(frame, plan)


def _scene(frame: EnuFrame) -> JSON:
    crs: CRS = _chart(frame).with_heights
    shift = {"scale": [1.0, 1.0, 1.0], "shift": [0.0, 0.0, -frame.height_m], "swap_xy": False}
    return {"crs": {"definition": crs.to_wkt("WKT2_2019")}, "base_to_canonical": shift}


def _poses(cameras_enu: Sequence[Camera], frame: EnuFrame) -> list[JSON]:
    """Positions and angles in the projection, whose axes turn with the Earth's surface, unlike ENU's."""
    chart, found = _chart(frame), []
    for camera in cameras_enu:
        ends = chart.map_from_enu(camera.centre + np.vstack([np.zeros(3), np.eye(3)]))
        left, _, right = np.linalg.svd((ends[1:] - ends[0]).T)
        world_from_image = (left @ right) @ camera.cam_from_world.rotation.T * [1.0, -1.0, -1.0]
        angles: Array = Rotation.from_matrix(world_from_image).as_euler("XYZ", degrees=True)
        position = ends[0] - [0.0, 0.0, frame.height_m]
        found.append({"position": position.tolist(), "orientation_deg": angles.tolist()})
    return found


def _internals(lens: Intrinsics) -> JSON:
    k1, k2, p1, p2 = lens.distortion
    return {
        "type": "perspective",
        "principal_point_px": [lens.cx, lens.cy],
        "focal_length_px": float(np.sqrt(lens.fx * lens.fy)),
        "radial_distortion": [k1, k2, 0.0],
        "tangential_distortion": [p1, p2],
    }


def _sensor(lens: Intrinsics, number: int) -> JSON:
    weights = {"Red": 0.2126, "Green": 0.7152, "Blue": 0.0722}
    return {
        "id": number,
        "name": f"lens {number}",
        "bands": [{"name": name, "weight": weight} for name, weight in weights.items()],
        "image_size_px": [lens.width, lens.height],
        # The format requires a size; only lengths in millimetres, of which there are none here, depend on it.
        "pixel_size_um": FULL_FRAME_UM / max(lens.width, lens.height),
        "internals": _internals(lens),
        "shutter_type": "global",
    }


def _capture(number: int, sensor: int, row: CameraRow, time: datetime) -> JSON:
    camera = {
        "id": number,
        "sensor_id": sensor,
        "model_source": "user",
        "pixel_type": "uint8",
        "pixel_range": {"min": 0.0, "max": 255.0},
        "image_orientation": 1,
    }
    known = row.height is not None and row.ce90 is not None and row.le90 is not None
    place = {"geolocation": _geolocation(row)} if known else {}
    return {
        "id": number,
        "reference_camera_id": number,
        "cameras": [camera],
        "rig_model_source": "not_applicable",
        "time": time.isoformat(),
        **place,
    }


def _geolocation(row: CameraRow) -> JSON:
    assert row.ce90 is not None and row.le90 is not None
    across, up = row.ce90 / CE90_PER_SIGMA, row.le90 / LE90_PER_SIGMA
    # In the order of the CRS's axes: latitude first.
    return {
        "crs": {"definition": "EPSG:4979"},
        "coordinates": [row.lat, row.lon, row.height],
        "sigmas": [across, across, up],
    }
