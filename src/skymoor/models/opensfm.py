# SPDX-License-Identifier: Apache-2.0
"""OpenSfM's reconstruction.json."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from skymoor.models.checks import checked_points, json_of, readable
from skymoor.models.colmap import FEWEST_POINTS, WITHOUT_PHOTOS, found_photos
from skymoor.models.given import Cloud, GivenModel, Part
from skymoor.models.posed import Posed, component_of_posed


def read_opensfm(path: Path, photos: Path | None = None) -> GivenModel:
    """The largest reconstruction, with its photos if they are there. Raises `InputError` where it cannot be used."""
    content = json_of(path)
    with readable(path, "reconstruction of OpenSfM"):
        largest = max(content, key=lambda one: len(one.get("shots", {})))
        cameras = [
            _posed(name, shot, largest["cameras"][shot["camera"]]) for name, shot in sorted(largest["shots"].items())
        ]
        found = list(largest.get("points", {}).values())
        points = np.array([one["coordinates"] for one in found], np.float64).reshape(-1, 3)
        colours = np.array([one["color"] for one in found], np.float64).reshape(-1, 3)
    points = checked_points(points, path, fewest=FEWEST_POINTS)
    shown = np.clip(np.nan_to_num(colours), 0, 255).astype(np.uint8)
    files = found_photos([one.image for one in cameras], photos, path.parent)
    component, pictures = component_of_posed(cameras, points, shown, files, path)
    notes = [WITHOUT_PHOTOS.format(path)] if pictures is None else []
    if len(content) > 1:
        notes.append(f"{path}: has {len(content)} reconstructions in frames of their own; the largest is registered")
    cloud = Cloud(points, shown if shown.any() else None)
    part = Part("opensfm", path)
    return GivenModel(
        path.parent.name, (part,), cloud, sparse=True, component=component, photos=pictures, notes=tuple(notes)
    )


def _posed(name: str, shot: Mapping[str, Any], camera: Mapping[str, Any]) -> Posed:
    width, height = int(camera["width"]), int(camera["height"])
    side, kind = float(max(width, height)), camera["projection_type"]
    k1, k2, k3, k4, p1, p2 = (float(camera.get(key, 0.0)) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    fx = side * float(camera["focal_x"] if "focal_x" in camera else camera["focal"])
    fy = side * float(camera["focal_y"]) if "focal_y" in camera else fx
    # Lengths are shares of the longer side, counted from the middle.
    pinhole = (
        fx,
        fy,
        width / 2 + side * float(camera.get("c_x", 0.0)),
        height / 2 + side * float(camera.get("c_y", 0)),
    )
    if kind in ("perspective", "brown"):
        model, more = "FULL_OPENCV", (k1, k2, p1, p2, k3, 0.0, 0.0, 0.0)
        if not k3:
            model, more = "OPENCV", (k1, k2, p1, p2)  # type: ignore[assignment]
    elif kind in ("fisheye", "fisheye_opencv"):
        model, more = "OPENCV_FISHEYE", (k1, k2, k3, k4)  # type: ignore[assignment]
    else:
        raise ValueError(f"projection {kind} is not read")
    rotation = Rotation.from_rotvec(np.array(shot["rotation"], np.float64)).as_matrix()
    return Posed(name, model, width, height, (*pinhole, *more), rotation, np.array(shot["translation"], np.float64))
