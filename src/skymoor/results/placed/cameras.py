# SPDX-License-Identifier: Apache-2.0
"""Cameras of other programs in metres of the site, in their own files."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity
from skymoor.models.bundler import parsed
from skymoor.models.colmap import open_colmap
from skymoor.models.metashape import open_metashape, world_from_chunk
from skymoor.models.realityscan import rotation_of, table_of
from skymoor.results.formats.gltf import ecef_from_enu
from skymoor.results.placed.placement import Placement
from skymoor.types import Array

WGS84 = (
    'GEOGCS["WGS 84",DATUM["World Geodetic System 1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.01745329251994328],AUTHORITY["EPSG","4326"]]'
)


def move_colmap(path: Path, folder: Path, placement: Placement) -> list[str]:
    """The model with all its cameras, rigs and observations, binary or text as it was."""
    model, target = open_colmap(path), folder / "colmap"
    target.mkdir()
    move = placement.enu_from_model
    model.transform(pycolmap.Sim3d(move.scale, pycolmap.Rotation3d(move.rotation), move.translation))
    if (path / "cameras.bin").is_file():
        model.write_binary(str(target))
    else:
        model.write_text(str(target))
    if not (target / "points3D.bin").is_file() and not (target / "points3D.txt").is_file():
        raise OSError(errno.ENOSPC, "COLMAP could not write all of it, is the disk full?", str(target))
    return []


def move_nerfstudio(path: Path, folder: Path, placement: Placement) -> list[str]:
    """transforms.json with poses in ENU; the cloud that it names is a part of its own."""
    content = json.loads(path.read_text(encoding="utf-8"))
    move = placement.enu_from_model
    for frame in content["frames"]:
        pose = np.array(frame["transform_matrix"], np.float64)
        pose[:3, :3] = move.rotation @ pose[:3, :3]
        pose[:3, 3] = move.apply(pose[:3, 3])
        frame["transform_matrix"] = pose.tolist()
    if content.get("ply_file_path"):
        content["ply_file_path"] = Path(str(content["ply_file_path"])).name
    # They led from the frame before, which is none of this file any more.
    for key in ("applied_transform", "applied_scale"):
        content.pop(key, None)
    _write_json(folder / path.name, content | placement.described())
    return []


def move_opensfm(path: Path, folder: Path, placement: Placement) -> list[str]:
    """reconstruction.json in ENU around its reference_lla; of several reconstructions the largest."""
    content = json.loads(path.read_text(encoding="utf-8"))
    largest = max(content, key=lambda one: len(one.get("shots", {})))
    move, frame = placement.enu_from_model, placement.frame
    for shot in largest["shots"].values():
        rotation, translation = _moved_pose(
            Rotation.from_rotvec(np.array(shot["rotation"], np.float64)).as_matrix(),
            np.array(shot["translation"], np.float64),
            move,
        )
        shot["rotation"] = Rotation.from_matrix(rotation).as_rotvec().tolist()
        shot["translation"] = translation.tolist()
    for point in largest.get("points", {}).values():
        point["coordinates"] = move.apply(point["coordinates"]).tolist()
    lla = {"latitude": frame.lat_deg, "longitude": frame.lon_deg, "altitude": frame.height_m}
    largest["reference_lla"] = lla
    _write_json(folder / path.name, [largest])
    _write_json(folder / "reference_lla.json", lla)
    return []


def move_bundler(path: Path, folder: Path, placement: Placement) -> list[str]:
    """bundle.out in ENU; lines of observations stay as they are."""
    cameras, points, _ = parsed(path)
    lines = path.read_text().splitlines()
    at = [k for k, line in enumerate(lines) if line.strip() and not line.startswith("#")][1:]
    move = placement.enu_from_model
    for index, camera in enumerate(cameras):
        if camera[0, 0] <= 0:  # without a pose
            continue
        rotation, translation = _moved_pose(camera[1:4], camera[4], move)
        for row, values in enumerate([*rotation, translation], start=1):
            lines[at[5 * index + row]] = " ".join(f"{value:.17g}" for value in values)
    for index, xyz in enumerate(move.apply(points)):
        lines[at[5 * len(cameras) + 3 * index]] = " ".join(f"{value:.17g}" for value in xyz)
    (folder / path.name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return []


def move_metashape(path: Path, folder: Path, placement: Placement) -> list[str]:
    """The XML with the transform of its chunk, from which Metashape has all positions on Earth."""
    tree = open_metashape(path)
    ecef = ecef_from_enu(placement.frame)
    on_earth = Similarity(1.0, ecef[:3, :3], ecef[:3, 3]) @ placement.enu_from_model @ world_from_chunk(tree)
    chunk = tree.find("chunk")
    assert chunk is not None
    node = _child(chunk, "transform")
    for name, values in (
        ("rotation", on_earth.rotation.ravel()),
        ("translation", on_earth.translation),
        ("scale", np.array([on_earth.scale])),
    ):
        _child(node, name).text = " ".join(f"{value:.17g}" for value in values)
    _child(chunk, "reference").text = WGS84
    tree.write(folder / path.name, encoding="UTF-8", xml_declaration=True)
    return []


def move_realityscan(path: Path, folder: Path, placement: Placement) -> list[str]:
    """The CSV with positions on the map, heights above the ellipsoid, and directions."""
    names, rows = table_of(path)
    lines = [",".join(names)]
    turn = placement.enu_from_model.rotation
    for row in rows:
        x, y, height = placement.map([[float(row[name]) for name in ("x", "y", "alt")]])[0]
        moved = row | {"x": f"{x:.4f}", "y": f"{y:.4f}", "alt": f"{height:.4f}"}
        rotation = rotation_of(row)
        if rotation is not None:
            yaw, pitch, roll = Rotation.from_matrix(turn @ rotation).as_euler("ZXY", degrees=True)
            key = "heading" if "heading" in row else "yaw"
            moved |= {key: f"{-yaw % 360:.6f}", "pitch": f"{pitch:.6f}", "roll": f"{roll:.6f}"}
        lines.append(",".join(moved.values()))
    (folder / path.name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return []


def _moved_pose(rotation: Array, translation: Array, move: Similarity) -> tuple[Array, Array]:
    """Camera from target, of a pose from the model's world; the camera's own axes do not matter."""
    turned = rotation @ move.rotation.T
    return turned, -turned @ move.apply(-rotation.T @ translation)


def _child(node: Element, name: str) -> Element:
    found = node.find(name)
    return SubElement(node, name) if found is None else found


def _write_json(path: Path, content: object) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
