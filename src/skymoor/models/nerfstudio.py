# SPDX-License-Identifier: Apache-2.0
"""transforms.json of nerfstudio and its relatives, with the cloud that it names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skymoor.engines.regular import is_there
from skymoor.errors import InputError
from skymoor.models.checks import json_of, readable
from skymoor.models.given import Cloud, GivenModel, Part
from skymoor.models.ply import read_ply
from skymoor.models.posed import Posed, component_of_posed

OPENGL = np.array([1.0, -1.0, -1.0])
"""Camera axes of the file: x right, y up, z backwards."""


def read_nerfstudio(path: Path, photos: Path | None = None) -> GivenModel:
    """Cameras, the cloud and the photos. Raises `InputError` where they cannot be used, or no cloud is named."""
    content = json_of(path)
    with readable(path, "file of nerfstudio's cameras"):
        cameras = [_posed(content, frame) for frame in content["frames"]]
        named = content.get("ply_file_path") or "sparse_pc.ply"
    cloud_file = path.parent / str(named)
    if not is_there(cloud_file):
        raise InputError(
            f"{path}: the cloud {named} is not beside it, and cameras alone are no model; add ply_file_path, or give "
            "the COLMAP folder that it was made from"
        )
    cloud = read_ply(cloud_file)
    surface = cloud.surface
    assert isinstance(surface, Cloud)
    folders = [folder for folder in (photos, path.parent) if folder is not None]
    files = {
        one.image: file
        for one in cameras
        for folder in folders
        for file in (folder / one.image, folder / Path(one.image).name)
        if is_there(file)
    }
    component, pictures = component_of_posed(cameras, surface.points, surface.colours, files, path)
    parts = (Part("nerfstudio", path), *cloud.parts)
    return GivenModel(path.parent.name, parts, surface, sparse=True, component=component, photos=pictures)


def _posed(content: Mapping[str, Any], frame: Mapping[str, Any]) -> Posed:
    lens = {**{key: value for key, value in content.items() if key != "frames"}, **frame}
    width, height = int(lens["w"]), int(lens["h"])
    angle = lens.get("camera_angle_x")
    fx = float(lens["fl_x"] if "fl_x" in lens else width / 2 / np.tan(float(angle) / 2))  # type: ignore[arg-type]
    pinhole = (fx, float(lens.get("fl_y", fx)), float(lens.get("cx", width / 2)), float(lens.get("cy", height / 2)))
    k1, k2, k3, k4, p1, p2 = (float(lens.get(name, 0.0)) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    kind = str(lens.get("camera_model", "OPENCV"))
    if "FISHEYE" in kind:
        model, more = "OPENCV_FISHEYE", (k1, k2, k3, k4)
    elif kind in ("EQUIRECTANGULAR", "ORTHOPHOTO"):
        raise ValueError(f"camera model {kind} has no pinhole form")
    elif k3 or k4:
        model, more = "FULL_OPENCV", (k1, k2, p1, p2, k3, k4, 0.0, 0.0)  # type: ignore[assignment]
    else:
        model, more = "OPENCV", (k1, k2, p1, p2)
    world_from_cam = np.array(frame["transform_matrix"], np.float64)[:3, :4]
    rotation = (world_from_cam[:, :3] * OPENGL).T
    return Posed(
        str(frame["file_path"]), model, width, height, (*pinhole, *more), rotation, -rotation @ world_from_cam[:, 3]
    )
