# SPDX-License-Identifier: Apache-2.0
"""Cameras as KML, for globes."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from numpy.typing import ArrayLike

from skymoor.results.tables import CameraRow

KML = "http://www.opengis.net/kml/2.2"
ABSOLUTE = "Altitudes are metres above the EGM96 geoid, as KML requires."
CLAMPED = (
    "No EGM96 geoid grid was installed, or heights are not confirmed, so points are clamped to the ground; "
    "ellipsoidal_height is metres above the WGS 84 ellipsoid."
)


def cameras_kml(rows: Sequence[CameraRow], egm96_heights: ArrayLike | None) -> bytes:
    """Placemarks of registered cameras: longitude, latitude and, where (n,) heights above EGM96 are given, altitude."""
    root = ET.Element("kml", xmlns=KML)
    document = ET.SubElement(root, "Document")
    _add(document, "name", "skymoor cameras")
    _add(document, "description", CLAMPED if egm96_heights is None else ABSOLUTE)
    heights = [None] * len(rows) if egm96_heights is None else [float(one) for one in list(egm96_heights)]  # type: ignore[arg-type]
    for row, height in zip(rows, heights, strict=True):
        mark = ET.SubElement(document, "Placemark")
        _add(mark, "name", row.image)
        data = ET.SubElement(mark, "ExtendedData")
        for name, value in (("ellipsoidal_height", row.height), ("ce90_m", row.ce90), ("le90_m", row.le90)):
            _add(ET.SubElement(data, "Data", name=name), "value", "" if value is None else f"{value:.4f}")
        point = ET.SubElement(mark, "Point")
        _add(point, "altitudeMode", "clampToGround" if height is None else "absolute")
        position = f"{row.lon:.10f},{row.lat:.10f}"
        _add(point, "coordinates", position if height is None else f"{position},{height:.4f}")
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _add(parent: ET.Element, name: str, text: str) -> None:
    ET.SubElement(parent, name).text = text
