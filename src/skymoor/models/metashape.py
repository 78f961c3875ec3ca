# SPDX-License-Identifier: Apache-2.0
"""Cameras of Metashape (XML), which are moved with the mesh or cloud beside them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from skymoor.errors import InputError
from skymoor.geometry import Similarity
from skymoor.models.checks import readable
from skymoor.models.posed import Posed
from skymoor.types import Array

NO_TRANSFORM = Similarity(1.0, np.eye(3), np.zeros(3))


def open_metashape(path: Path) -> ET.ElementTree:
    """The document. Raises `InputError` where it is none, or its chunk is georeferenced already."""
    with readable(path, "XML of Metashape"):
        text = path.read_text(encoding="utf-8")
        if "<!DOCTYPE" in text or "<!ENTITY" in text:  # no program writes them, and they may grow without end
            raise ValueError("it declares entities")
        tree = ET.ElementTree(ET.fromstring(text))
    chunk = tree.find("chunk")
    if chunk is None or chunk.find("cameras") is None:
        raise InputError(f"{path}: has no cameras; export them again from Metashape as XML")
    reference = chunk.findtext("reference") or ""
    if chunk.find("transform/scale") is not None and not reference.startswith("LOCAL_CS"):
        raise InputError(
            f"{path}: its chunk is georeferenced, so its cameras do not share the coordinates of the mesh; leave the "
            "XML out, or export both from a chunk with local coordinates"
        )
    return tree


def world_from_chunk(tree: ET.ElementTree) -> Similarity:
    """The transform of a chunk in local coordinates; the identity where it has none."""
    node = tree.find("chunk/transform")
    if node is None or node.find("rotation") is None:
        return NO_TRANSFORM
    rotation = _numbers(node.findtext("rotation"), 9).reshape(3, 3)
    scale = float(node.findtext("scale") or 1.0)
    shift = np.zeros(3) if node.find("translation") is None else _numbers(node.findtext("translation"), 3)
    return Similarity(scale, rotation, shift)


def cameras_of_metashape(path: Path) -> list[Posed]:
    """Cameras with a pose, in the coordinates of the mesh. Raises `InputError` where they cannot be used."""
    tree = open_metashape(path)
    with readable(path, "file of Metashape's cameras"):
        lenses = {node.get("id"): _lens(node) for node in tree.iterfind("chunk/sensors/sensor")}
        move = world_from_chunk(tree)
        found = []
        for node in tree.iterfind("chunk/cameras//camera"):
            lens, text = lenses.get(node.get("sensor_id")), node.findtext("transform")
            if lens is None or text is None:
                continue
            pose = _numbers(text, 16).reshape(4, 4)
            rotation = (move.rotation @ pose[:3, :3]).T
            centre = move.apply(pose[:3, 3])
            found.append(Posed(str(node.get("label")), *lens, rotation, -rotation @ centre))
    if not found:
        raise InputError(f"{path}: no camera has a pose; align the photos, and export it again")
    return found


def _numbers(text: str | None, count: int) -> Array:
    values = np.array((text or "").split(), np.float64)
    if len(values) != count:
        raise ValueError(f"{len(values)} numbers in the place of {count}")
    return values


def _lens(node: ET.Element) -> tuple[str, int, int, tuple[float, ...]] | None:
    """COLMAP's name, size and parameters of a sensor; None where it is not calibrated or no frame camera."""
    found = [one for one in node.iterfind("calibration") if one.find("f") is not None]
    adjusted = next((one for one in found if one.get("class") == "adjusted"), found[0] if found else None)
    if adjusted is None or node.get("type", "frame") not in ("frame", "fisheye"):
        return None
    size = adjusted.find("resolution")
    size = node.find("resolution") if size is None else size
    if size is None:
        return None
    width, height = int(size.get("width", 0)), int(size.get("height", 0))
    names = ("f", "cx", "cy", "b1", "k1", "k2", "k3", "k4", "p1", "p2")
    f, cx, cy, b1, k1, k2, k3, k4, p1, p2 = (float(adjusted.findtext(name) or 0.0) for name in names)
    # The principal point counts from the middle; its tangential terms stand in the other order than OpenCV's.
    pinhole = (f + b1, f, width / 2 + cx, height / 2 + cy)
    if node.get("type") == "fisheye":
        return "OPENCV_FISHEYE", width, height, (*pinhole, k1, k2, k3, k4)
    if k3:
        return "FULL_OPENCV", width, height, (*pinhole, k1, k2, p2, p1, k3, 0.0, 0.0, 0.0)
    return "OPENCV", width, height, (*pinhole, k1, k2, p2, p1)
