# SPDX-License-Identifier: Apache-2.0
"""Textured meshes in metres of the site: nothing but positions and normals changes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from skymoor.models.mesh import gltf_json, images_of, materials_of, with_json
from skymoor.results.formats.gltf import origin_of
from skymoor.results.placed.placement import Placement

YUP_FROM_ENU = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def move_obj(path: Path, folder: Path, placement: Placement) -> list[str]:
    """x east, y north, z up; materials and images are copied beside it."""
    with path.open("rb") as source, (folder / path.name).open("wb") as target:
        for comment in placement.comments():
            target.write(f"# {comment}\n".encode())
        for line in source:
            target.write(_moved(line, placement))
    for name in materials_of(path):
        for file in (name, *images_of(path.parent / name)):
            _copy(path.parent, folder, file)
    return []


def _moved(line: bytes, placement: Placement) -> bytes:
    """A line of an OBJ; colours may follow a position."""
    words = line.split()
    if len(words) < 4 or words[0] not in (b"v", b"vn"):
        return line
    xyz = np.array([[float(word) for word in words[1:4]]])
    moved = placement.enu(xyz)[0] if words[0] == b"v" else placement.directions(xyz)[0]
    return b" ".join([words[0], *(f"{value:.6f}".encode() for value in moved), *words[4:]]) + b"\n"


def move_gltf(path: Path, folder: Path, placement: Placement) -> list[str]:
    """Below a new root: x east, y up, z south, as the format has it."""
    content = gltf_json(path)
    matrix = YUP_FROM_ENU @ placement.enu_from_model.matrix()
    nodes = content.setdefault("nodes", [])
    for scene in content.get("scenes", []):
        nodes.append({"name": "skymoor", "matrix": matrix.T.ravel().tolist(), "children": scene.get("nodes", [])})
        scene["nodes"] = [len(nodes) - 1]
    content["asset"]["extras"] = {**content["asset"].get("extras", {}), **origin_of(placement.frame)}
    data = path.read_bytes()
    moved = with_json(data, content) if data.startswith(b"glTF") else json.dumps(content).encode()
    (folder / path.name).write_bytes(moved)
    files = [one["uri"] for kind in ("images", "buffers") for one in content.get(kind, []) if "uri" in one]
    for uri in files:
        if not uri.startswith("data:"):
            _copy(path.parent, folder, unquote(uri))
    return []


def _copy(source: Path, folder: Path, name: str) -> None:
    """A file beside a mesh; what lies elsewhere is copied by its name alone."""
    target = folder / name
    if not target.resolve().is_relative_to(folder.resolve()):
        target = folder / Path(name).name
    target.parent.mkdir(parents=True, exist_ok=True)
    if not target.exists():
        shutil.copyfile(source / name, target)
