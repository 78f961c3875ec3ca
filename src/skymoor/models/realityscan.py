# SPDX-License-Identifier: Apache-2.0
"""Cameras of RealityScan (RealityCapture) as CSV, which are moved with the mesh or cloud beside them."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from skymoor.models.checks import readable
from skymoor.types import Array

NEEDED = ("x", "y", "alt")


def table_of(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Column headings as they are, and rows by their names without the mark. Raises `InputError`."""
    with readable(path, "table of cameras with name, x, y and alt"):
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = [line for line in csv.reader(file) if line and not line[0].startswith("#cameras")]
        names = lines[0]
        plain = [name.strip().lstrip("#").lower() for name in names]
        rows = [dict(zip(plain, line, strict=True)) for line in lines[1:]]
        if not rows or not all(np.isfinite(float(row[name])) for row in rows for name in NEEDED):
            raise ValueError("a position is missing")
    return names, rows


def rotation_of(row: Mapping[str, str]) -> Array | None:
    """World from camera (3, 3), with the camera's x right, y up and z backwards; None where no angles are stated."""
    key = "heading" if "heading" in row else "yaw"
    if key not in row or "pitch" not in row or "roll" not in row:
        return None
    angles = [-float(row[key]), float(row["pitch"]), float(row["roll"])]
    return np.asarray(Rotation.from_euler("ZXY", angles, degrees=True).as_matrix(), np.float64)
