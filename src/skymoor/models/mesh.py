# SPDX-License-Identifier: Apache-2.0
"""Meshes with textures: OBJ and glTF."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from skymoor.engines.libraries import require
from skymoor.errors import InputError
from skymoor.models.checks import checked_points, checked_triangles, geocentric_up, readable
from skymoor.models.given import Y_UP, GivenModel, Mesh, Part
from skymoor.types import Image

TALLER = 1.5
"""Ratio of the extents along y and z from which y is not up: places are wider than they are high."""
JSON_CHUNK = b"JSON"
OWN_COLOURS = "_SKYMOOR_COLOURS"
PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


def read_obj(path: Path) -> GivenModel:
    """An OBJ with its materials. Raises `InputError` where it cannot be used, or an image of it is missing."""
    for name in (path.name, *materials_of(path)):
        _require_images(path, images_of(path.parent / name) if name != path.name else ())
    mesh = _loaded(path)
    return GivenModel(path.stem, (Part("obj", path),), mesh, up=geocentric_up(mesh.vertices))


def read_gltf(path: Path) -> GivenModel:
    """A GLB, or a glTF with its files. Raises as `read_obj`; y is up, unless the model would be higher than wide."""
    content = gltf_json(path)
    packed = next((one for one in PACKED if one in content.get("extensionsRequired", ())), None)
    if packed is not None:
        raise InputError(f"{path}: is compressed ({packed}); export it without compression")
    files = [one["uri"] for kind in ("images", "buffers") for one in content.get(kind, []) if "uri" in one]
    _require_images(path, [unquote(uri) for uri in files if not uri.startswith("data:")])
    mesh = _loaded(path, _with_vertex_colours(path, content))
    low, high = np.percentile(mesh.vertices, [1, 99], axis=0)
    is_y_up = high[1] - low[1] < TALLER * (high[2] - low[2])
    up = geocentric_up(mesh.vertices)
    return GivenModel(path.stem, (Part("gltf", path),), mesh, up=(Y_UP if is_y_up else None) if up is None else up)


def _with_vertex_colours(path: Path, content: dict[str, Any]) -> bytes:
    """The file with colours of vertices as a plain attribute, where their material has no image.

    trimesh drops them beside a material, and reads colours of 16 bits as if they had 8.
    """
    materials = content.get("materials", [])
    for mesh in content.get("meshes", []):
        for one in mesh.get("primitives", []):
            look = materials[one["material"]] if one.get("material", len(materials)) < len(materials) else {}
            if "COLOR_0" in one.get("attributes", {}) and "Texture" not in json.dumps(look):
                one["attributes"][OWN_COLOURS] = one["attributes"].pop("COLOR_0")
    data = path.read_bytes()
    return with_json(data, content) if data.startswith(b"glTF") else json.dumps(content).encode()


def with_json(data: bytes, content: dict[str, Any]) -> bytes:
    """A GLB with another JSON and the same binary chunk."""
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), JSON_CHUNK) + text + data[20 + struct.unpack_from("<I", data, 12)[0] :]
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def gltf_json(path: Path) -> dict[str, Any]:
    """The JSON of a glTF or GLB. Raises `InputError` where there is none."""
    try:
        data = path.read_bytes()
        if data.startswith(b"glTF"):
            length, kind = struct.unpack_from("<I4s", data, 12)
            if kind != JSON_CHUNK:
                raise ValueError("its first chunk is no JSON")
            data = data[20 : 20 + length]
        content = json.loads(data)
        if not isinstance(content, dict):
            raise ValueError("it is no object")
    except (OSError, ValueError, struct.error, RecursionError) as error:
        raise InputError(f"{path}: is no glTF that can be read ({error}); export it again") from error
    return content


def materials_of(path: Path) -> list[str]:
    """Files of materials that an OBJ names."""
    return _named(path, b"mtllib ")


def images_of(path: Path) -> list[str]:
    """Files of images that a file of materials names."""
    if not path.is_file():
        raise InputError(f"{path}: the materials of the mesh are missing; put them beside it")
    return sorted({name.split()[-1] if " -" in f" {name}" else name for name in _named(path, b"map_Kd ")})


def _named(path: Path, key: bytes) -> list[str]:
    """What follows a key at the beginning of lines."""
    try:
        with path.open("rb") as file:
            lines = [line.strip() for line in file if line.lstrip().startswith(key)]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    return [line[len(key) :].decode("utf-8", "replace").strip() for line in lines]


def _require_images(path: Path, names: Sequence[str]) -> None:
    missing = [name for name in names if not (path.parent / name).is_file()]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(f"{path}: its texture {missing[0]}{more} is missing; put it beside the mesh")


def _loaded(path: Path, content: bytes | None = None) -> Mesh:
    """All triangles of a scene, as trimesh reads it; of `content` in the place of the file's."""
    trimesh = require("trimesh", "models")
    with readable(path, "mesh"):
        if content is None:
            scene = trimesh.load_scene(str(path), process=False)
        else:
            beside = trimesh.resolvers.FilePathResolver(str(path))
            kind = "glb" if content.startswith(b"glTF") else "gltf"
            scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, resolver=beside, process=False)
        parts = [one for one in scene.dump() if hasattr(one, "faces") and len(one.faces)]
    if not parts:
        raise InputError(f"{path}: has no triangles; export the mesh, or the cloud as LAZ or PLY")
    starts = np.cumsum([0, *(len(one.vertices) for one in parts)])
    vertices = checked_points(np.concatenate([one.vertices for one in parts]), path)
    triangles = np.concatenate(
        [
            checked_triangles(np.asarray(one.faces, np.int64), len(one.vertices), path) + start
            for one, start in zip(parts, starts, strict=False)
        ]
    )
    images = [_image(one) for one in parts]
    textures = [image for image in images if image is not None]
    if not textures:
        colours = [_colours(one) for one in parts]
        known = all(one is not None for one in colours)
        return Mesh(vertices, triangles, np.concatenate(colours) if known else None)  # type: ignore[arg-type]
    index = np.cumsum([image is not None for image in images]) - 1
    uv, face_texture = [], []
    for one, image, k in zip(parts, images, index, strict=True):
        faces = np.asarray(one.faces)
        own = image is not None
        uv.append(np.asarray(one.visual.uv, np.float32)[faces] if own else np.zeros((len(faces), 3, 2), np.float32))
        face_texture.append(np.full(len(faces), k if own else -1, np.int32))
    known_uv = np.nan_to_num(np.concatenate(uv), posinf=0, neginf=0)
    return Mesh(vertices, triangles, None, known_uv, np.concatenate(face_texture), tuple(textures))


def _image(part: Any) -> Image | None:
    """The colour texture of a part of a scene."""
    material = getattr(part.visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    uv = getattr(part.visual, "uv", None)
    return None if image is None or uv is None else np.asarray(image.convert("RGB"), np.uint8)


def _colours(part: Any) -> Image | None:
    own = next((values for name, values in part.vertex_attributes.items() if name.strip("_") == OWN_COLOURS[1:]), None)
    if own is not None:
        largest = np.iinfo(own.dtype).max if own.dtype.kind == "u" else 1.0
        linear = np.clip(np.asarray(own, np.float64)[:, :3] / largest, 0, 1)
        # glTF counts light, pictures what the eye sees.
        seen = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        return np.asarray(np.rint(255 * seen), np.uint8)
    if part.visual.kind != "vertex":
        return None
    return np.asarray(part.visual.vertex_colors, np.uint8)[:, :3]
