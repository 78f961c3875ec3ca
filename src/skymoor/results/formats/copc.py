# SPDX-License-Identifier: Apache-2.0
"""Point clouds as COPC: a LAZ file whose points are an octree, which is read in parts over a network."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray

from skymoor.engines.libraries import require
from skymoor.types import Array

Indices = NDArray[np.int64]

CELLS = 128  # along the side of a node, of each of which it keeps one point; the specification's root spacing
LEAF_POINTS = 50_000
DEEPEST = 20


def write_copc(source: Path, target: Path, rng: np.random.Generator) -> None:
    """Write the points of a .laz of `pointcloud_las` in COPC's order (COPC 1.0), values, scales and CRS as they are.

    Every point is in one node of the octree. A node with more than 50,000 points left keeps one, chosen by `rng`, in
    each cell of a 128th of its side, and hands the rest to its children. Raises `BackendUnavailable` where copclib is
    missing.
    """
    copclib = require("copclib", "export")
    cloud = laspy.read(source)
    header, xyz = cloud.header, np.asarray(cloud.xyz)
    low, side = _cube(xyz)
    scale, offset = copclib.Vector3(*header.scales), copclib.Vector3(*header.offsets)
    config = copclib.CopcConfigWriter(header.point_format.id, scale, offset, header.parse_crs().to_wkt())
    centre = low + side / 2
    info = config.copc_info
    info.center_x, info.center_y, info.center_z, info.halfsize, info.spacing = *centre, side / 2, side / CELLS
    config.las_header.min, config.las_header.max = (copclib.Vector3(*end) for end in (header.mins, header.maxs))
    config.las_header.generating_software = "skymoor"
    config.las_header.points_by_return = [len(xyz), *[0] * 14]
    records = np.asarray(cloud.points.array)  # as LAS has them, byte by byte
    writer = copclib.FileWriter(str(target), config)
    for key, chosen in octree(xyz, low, side, rng):
        writer.AddNode(copclib.VoxelKey(*key), copclib.VectorChar(records[chosen].view(np.int8)))
    writer.Close()


def octree(
    xyz: Array, low: Array, side: float, rng: np.random.Generator
) -> Iterator[tuple[tuple[int, int, int, int], Indices]]:
    """Keys (depth, x, y, z) of nodes in the cube at `low`, and the indices of the points (n, 3) in each."""
    rest = rng.permutation(len(xyz)).astype(np.int64)
    for depth in range(DEEPEST + 1):
        unit = (xyz[rest] - low) / side * 2**depth
        node = np.minimum(unit.astype(np.int64), 2**depth - 1)
        flat = (node[:, 0] << 42) | (node[:, 1] << 21) | node[:, 2]
        _, of_node, count = np.unique(flat, return_inverse=True, return_counts=True)
        keep = _one_a_cell(of_node, np.minimum(((unit - node) * CELLS).astype(np.int64), CELLS - 1))
        keep |= (count <= LEAF_POINTS)[of_node] | (depth == DEEPEST)
        kept, nodes = rest[keep], node[keep]
        order = np.argsort(of_node[keep], kind="stable")
        ends = np.cumsum(np.bincount(of_node[keep], minlength=len(count)))
        for chosen in np.split(order, ends[:-1]):
            x, y, z = nodes[chosen[0]].tolist()
            yield (depth, x, y, z), np.sort(kept[chosen])  # neighbours in the source compress to a third
        rest = rest[~keep]
        if not len(rest):
            return


def _one_a_cell(of_node: Indices, cell: Indices) -> NDArray[np.bool_]:
    """True for the first point of each cell (n, 3) of each node (n,)."""
    key = ((of_node.astype(np.int64) * CELLS + cell[:, 0]) * CELLS + cell[:, 1]) * CELLS + cell[:, 2]
    first: NDArray[np.bool_] = np.zeros(len(key), bool)
    first[np.unique(key, return_index=True)[1]] = True
    return first


def _cube(xyz: Array) -> tuple[Array, float]:
    """The lower corner (3,) and the side of a cube around points (n, 3), a millimetre larger."""
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    side = float((high - low).max()) + 1e-3
    return np.asarray((low + high) / 2 - side / 2), side
