# SPDX-License-Identifier: Apache-2.0
"""The surface from above as a glTF mesh, and the 3D Tiles root that puts it on the globe."""

from __future__ import annotations

import json
import struct

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from skymoor.geo import EnuFrame
from skymoor.types import Array

FLOAT, UNSIGNED_SHORT, UNSIGNED_INT = 5126, 5123, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


def height_field(points_enu: Array, known: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.uint32]]:
    """The lattice's known nodes (flat indices), and triangles (n, 3) of those, seen from above counter-clockwise.

    `points_enu` (h, w, 3) has rows going south; a triangle is there where its three corners are known.
    """
    rows, columns = known.shape
    node = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = node[:-1, :-1], node[:-1, 1:], node[1:, :-1], node[1:, 1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    faces = faces[known.ravel()[faces].all(axis=1)]
    used, flat = np.unique(faces, return_inverse=True)
    return used, flat.reshape(-1, 3).astype(np.uint32)


def mesh_glb(points_enu: Array, colours: NDArray[np.uint8], faces: NDArray[np.uint32], frame: EnuFrame) -> bytes:
    """A .glb of vertices (n, 3) in ENU metres with colours (n, 3) and triangles (m, 3).

    glTF has y up: x is east, y up, z south. The origin is in `asset.extras`. Positions are floats, good to 0.1 mm
    within a kilometre of the origin.
    """
    east, north, up = points_enu.T
    xyz = np.column_stack([east, up, -north]).astype("<f4")
    linear = np.where(colours <= 10, colours / 255 / 12.92, ((colours / 255 + 0.055) / 1.055) ** 2.4)  # glTF's colours
    rgba = np.column_stack([np.rint(linear * 65535), np.full(len(xyz), 65535)]).astype("<u2")
    short = len(xyz) < 65535  # the highest index is reserved
    parts = [xyz.tobytes(), rgba.tobytes(), faces.astype("<u2" if short else "<u4").tobytes()]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    targets = (ARRAY_BUFFER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER)
    described = {
        "asset": {"version": "2.0", "generator": "skymoor", "extras": origin_of(frame)},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "materials": [{"extensions": {"KHR_materials_unlit": {}}, "doubleSided": True}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0}]}],
        "accessors": [
            _accessor(0, FLOAT, len(xyz), "VEC3") | {"min": xyz.min(axis=0).tolist(), "max": xyz.max(axis=0).tolist()},
            _accessor(1, UNSIGNED_SHORT, len(xyz), "VEC4") | {"normalized": True},
            _accessor(2, UNSIGNED_SHORT if short else UNSIGNED_INT, faces.size, "SCALAR"),
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part), "target": target}
            for start, part, target in zip(starts, parts, targets, strict=False)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    text = json.dumps(described).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(parts)  # every part but the last is a multiple of four bytes
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def tileset(points_enu: Array, frame: EnuFrame, uri: str) -> dict[str, object]:
    """tileset.json (3D Tiles 1.1) of one .glb: its root's transform is ECEF-from-ENU, columns first.

    A viewer turns glTF's y up to z up by itself, so the transform takes east, north, up.
    """
    low, high = points_enu.min(axis=0), points_enu.max(axis=0)
    half = np.diag(np.maximum((high - low) / 2, 0.01))
    root = {
        "transform": ecef_from_enu(frame).T.ravel().tolist(),
        "boundingVolume": {"box": [*((low + high) / 2).tolist(), *half.ravel().tolist()]},
        "geometricError": 0.0,
        "refine": "REPLACE",
        "content": {"uri": uri},
    }
    size = float(np.linalg.norm(high - low))
    return {"asset": {"version": "1.1", "extras": origin_of(frame)}, "geometricError": size, "root": root}


def origin_of(frame: EnuFrame) -> dict[str, object]:
    """The origin of a file in local metres, in words that a person finds in it."""
    return {
        "origin_wgs84": {"lat": frame.lat_deg, "lon": frame.lon_deg, "ellipsoidal_height_m": frame.height_m},
        "origin_ecef_m": ecef_from_enu(frame)[:3, 3].tolist(),
        "ecef_from_enu": ecef_from_enu(frame).tolist(),
    }


def ecef_from_enu(frame: EnuFrame) -> Array:
    """The rigid motion (4, 4) from the site's metres to geocentric ones (EPSG:4978)."""
    to_ecef = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    origin = to_ecef.transform(frame.lon_deg, frame.lat_deg, frame.height_m)
    lat, lon = np.radians([frame.lat_deg, frame.lon_deg])
    s, c, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    moved = np.eye(4)
    moved[:3] = np.column_stack([[-sl, cl, 0.0], [-s * cl, -s * sl, c], [c * cl, c * sl, s], origin])
    return moved


def _accessor(view: int, kind: int, count: int, shape: str) -> dict[str, object]:
    return {"bufferView": view, "componentType": kind, "count": count, "type": shape}
