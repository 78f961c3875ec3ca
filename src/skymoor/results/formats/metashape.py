# SPDX-License-Identifier: Apache-2.0
"""Cameras for Metashape: a reference table in WGS 84, and poses with calibration in metres of the site."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

import numpy as np

from skymoor.geometry import Intrinsics
from skymoor.results.formats.angles import angle_cells
from skymoor.results.tables import CameraRow
from skymoor.types import Camera

REFERENCE = "#Label,Longitude,Latitude,Altitude,Accuracy_XY_(m),Accuracy_Z_(m),Yaw,Pitch,Roll"
LOCAL = 'LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],UNIT["metre",1,AUTHORITY["EPSG","9001"]]]'


def metashape_reference(rows: Sequence[CameraRow], labels: Mapping[str, str]) -> str:
    """A table for File > Import > Import Reference in WGS 84: degrees, ellipsoidal metres, CE90 and LE90, angles.

    Cells stay empty where heights are not confirmed or something is not known.
    """
    lines = [REFERENCE]
    for row in rows:
        metres = ["" if one is None else f"{one:.4f}" for one in (row.height, row.ce90, row.le90)]
        lines.append(",".join([labels[row.image], f"{row.lon:.10f}", f"{row.lat:.10f}", *metres, *angle_cells(row)]))
    return "\n".join(lines) + "\n"


def metashape_cameras(cameras_enu: Sequence[Camera], labels: Mapping[str, str]) -> bytes:
    """An XML for File > Import > Import Cameras (Agisoft XML), in local coordinates: metres east, north, up.

    Transforms are world-from-camera with x right, y down, z forward. The principal point counts from the middle of the
    image, and tangential terms stand in the other order than OpenCV's (Metashape's manual, appendix on camera models).
    """
    root = ET.Element("document", version="2.0.0")
    chunk = ET.SubElement(root, "chunk", label="skymoor", enabled="true")
    lenses = {lens: str(k) for k, lens in enumerate(dict.fromkeys(camera.intrinsics for camera in cameras_enu))}
    sensors = ET.SubElement(chunk, "sensors", next_id=str(len(lenses)))
    for lens, number in lenses.items():
        _add_sensor(sensors, lens, number)
    cameras = ET.SubElement(chunk, "cameras", next_id=str(len(cameras_enu)), next_group_id="0")
    for k, camera in enumerate(cameras_enu):
        node = ET.SubElement(
            cameras, "camera", id=str(k), sensor_id=lenses[camera.intrinsics], label=labels[camera.image]
        )
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera.cam_from_world.rotation.T, camera.centre
        ET.SubElement(node, "transform").text = " ".join(repr(value) for value in pose.ravel().tolist())
    ET.SubElement(chunk, "reference").text = LOCAL
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _add_sensor(sensors: ET.Element, lens: Intrinsics, number: str) -> None:
    size = {"width": str(lens.width), "height": str(lens.height)}
    sensor = ET.SubElement(sensors, "sensor", id=number, label=f"lens {number}", type="frame")
    ET.SubElement(sensor, "resolution", size)
    calibration = ET.SubElement(sensor, "calibration", {"type": "frame", "class": "adjusted"})
    ET.SubElement(calibration, "resolution", size)
    k1, k2, p1, p2 = lens.distortion
    values = {"f": lens.fy, "cx": lens.cx - lens.width / 2, "cy": lens.cy - lens.height / 2, "b1": lens.fx - lens.fy}
    for name, value in (values | {"k1": k1, "k2": k2, "p1": p2, "p2": p1}).items():
        ET.SubElement(calibration, name).text = repr(float(value))
