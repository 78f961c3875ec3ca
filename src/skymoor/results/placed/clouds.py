# SPDX-License-Identifier: Apache-2.0
"""Clouds of a model on the map, with everything that their points carry."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np

from skymoor.models.given import Cloud
from skymoor.models.las import read_e57
from skymoor.results.formats.pointcloud import pointcloud_las
from skymoor.results.placed.placement import Placement

CHUNK = 1_000_000
STEP_M = 0.001
DEGREES_PER_STEP = 0.006
"""Of scan angles since LAS 1.4."""


def move_las(path: Path, folder: Path, placement: Placement) -> list[str]:
    """As LAZ 1.4 in the map projection, heights above the ellipsoid; classes, intensities and other fields stay."""
    with laspy.open(path) as source:
        header = _header(source.header, placement)
        first = True
        with laspy.open(folder / f"{path.name.split('.')[0]}.laz", "w", header=header, do_compress=True) as target:
            for points in source.chunk_iterator(CHUNK):
                xyz = placement.map(np.column_stack([points.x, points.y, points.z]))
                if first:
                    header.offsets = np.floor(xyz.mean(axis=0))
                    target.header.offsets = header.offsets
                    first = False
                target.write_points(_moved(points, xyz, header))
    return [f"{path.name}: is written as a plain LAZ file"] if path.name.lower().endswith(".copc.laz") else []


def _header(old: laspy.LasHeader, placement: Placement) -> laspy.LasHeader:
    names = set(old.point_format.dimension_names)
    number = 8 if "nir" in names else 7 if "red" in names else 6
    header = laspy.LasHeader(point_format=number, version="1.4")
    for extra in old.point_format.extra_dimensions:
        header.add_extra_dim(laspy.ExtraBytesParams(extra.name, extra.dtype or "u1", extra.description or ""))
    header.scales = np.full(3, STEP_M)
    middle = (np.asarray(old.mins) + np.asarray(old.maxs)) / 2
    header.offsets = np.floor(placement.map(middle)[0])
    header.generating_software = "skymoor"
    header.add_crs(placement.chart.with_heights)
    return header


def _moved(
    points: laspy.ScaleAwarePointRecord, xyz: np.ndarray, header: laspy.LasHeader
) -> laspy.ScaleAwarePointRecord:
    found = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
    old = set(points.point_format.dimension_names)
    for name in header.point_format.dimension_names:
        if name in old and name not in ("X", "Y", "Z"):
            found[name] = points[name]
    if "scan_angle_rank" in old:
        found["scan_angle"] = np.rint(np.asarray(points["scan_angle_rank"], np.float64) / DEGREES_PER_STEP)
    found.x, found.y, found.z = xyz.T
    return found


def move_e57(path: Path, folder: Path, placement: Placement) -> list[str]:
    """As LAZ in the map projection, with the colours."""
    cloud = read_e57(path).surface
    assert isinstance(cloud, Cloud)
    black = np.zeros((len(cloud.points), 3), np.uint8)
    colours = black if cloud.colours is None else cloud.colours
    content = pointcloud_las(placement.enu(cloud.points), colours, placement.frame, placement.crs)
    (folder / f"{path.stem}.laz").write_bytes(content)
    return [f"{path.name}: is written as LAZ, with positions and colours alone"]
