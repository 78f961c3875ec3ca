# SPDX-License-Identifier: Apache-2.0
"""Which kind of model files and folders are, by what they hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from skymoor.errors import InputError
from skymoor.models.checks import json_of
from skymoor.models.colmap import colmap_folder

# fmt: off
FileKind = Literal[
    "raster", "las", "ply", "e57", "obj", "gltf", "spz", "nerfstudio", "opensfm", "bundler", "metashape", "realityscan"
]
# fmt: on
BEGINS: tuple[tuple[bytes, FileKind], ...] = (
    (b"LASF", "las"),
    (b"ASTM-E57", "e57"),
    (b"glTF", "gltf"),
    (b"# Bundle file", "bundler"),
    (b"II*\0", "raster"),
    (b"MM\0*", "raster"),
    (b"II+\0", "raster"),
    (b"MM\0+", "raster"),
    (b"\x89PNG", "raster"),
    (b"\xff\xd8\xff", "raster"),
    (b"\0\0\0\x0cjP", "raster"),
)
ENDS: dict[str, FileKind] = {".obj": "obj", ".spz": "spz", ".vrt": "raster"}
NOT_READ = {
    **dict.fromkeys((".fbx", ".stl", ".3ds", ".dae", ".blend", ".usd", ".usdz"), "export it as GLB, OBJ or PLY"),
    **dict.fromkeys((".splat", ".ksplat", ".sog", ".rad"), "export the splat as PLY or SPZ"),
    **dict.fromkeys((".psx", ".psz", ".rsproj", ".rcproj"), "export cameras and model from the program"),
    **dict.fromkeys(
        (".xyz", ".pts", ".asc", ".csv.gz", ".pcd", ".rcp", ".rcs"), "convert the cloud to LAZ, PLY or E57"
    ),
    **dict.fromkeys((".b3dm", ".i3s", ".slpk", ".osgb"), "export the mesh as GLB or OBJ"),
    **dict.fromkeys((".ckpt", ".pt", ".pth"), "export the model from the program that trained it"),
}
KINDS = (
    "give a COLMAP, ODM, OpenSfM or nerfstudio folder, an orthophoto (GeoTIFF), a cloud (LAS, LAZ, E57, PLY), a mesh "
    "(PLY, OBJ, GLB) or a splat (PLY, SPZ)"
)


@dataclass(frozen=True)
class Found:
    """A file and its kind, or for `colmap` and `odm` a folder."""

    kind: FileKind | Literal["colmap", "odm"]
    path: Path


def find(paths: Sequence[Path]) -> list[Found]:
    """What the paths hold. Raises `InputError` for one that is not there, or no model that is read."""
    found = [one for path in paths for one in (_in_folder(path) if path.is_dir() else [_file(path)])]
    if not found:
        raise InputError(f"{paths[0]}: has no model; {KINDS}")
    return found


def _in_folder(path: Path) -> list[Found]:
    """A project's folder, or the files of a model that lie in one."""
    if (path / "odm_georeferencing").is_dir() or (path / "odm_orthophoto").is_dir():
        return [Found("odm", path)]
    folder = colmap_folder(path)
    for name, kind in (("transforms.json", "nerfstudio"), ("reconstruction.json", "opensfm")):
        if (path / name).is_file():
            return [Found(kind, path / name)]  # type: ignore[arg-type]
    if (path / "opensfm" / "reconstruction.json").is_file():
        return [Found("opensfm", path / "opensfm" / "reconstruction.json")]
    if folder is not None:
        return [Found("colmap", path)]
    found = []
    for file in sorted(one for one in path.iterdir() if one.is_file() and not one.name.startswith(".")):
        own = kind_of(file)
        # Textures of a mesh and photos are images, too.
        if own is not None and not (own == "raster" and file.suffix.lower() not in (".tif", ".tiff", ".vrt")):
            found.append(Found(own, file))
    return found


def _file(path: Path) -> Found:
    if not path.is_file():
        raise InputError(f"{path}: there is no such file or folder")
    kind = kind_of(path)
    if kind is None:
        raise InputError(f"{path}: is no model that is read; {NOT_READ.get(path.suffix.lower(), KINDS)}")
    return Found(kind, path)


def kind_of(path: Path) -> FileKind | None:
    """The kind of a file, by its first bytes where these tell it, else by its name; None if it is no model's."""
    try:
        with path.open("rb") as file:
            start = file.read(4096)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    known = next((kind for magic, kind in BEGINS if start.startswith(magic)), None)
    if known is not None:
        return known
    if start.startswith((b"ply\n", b"ply\r")):
        return "ply"
    suffix = path.suffix.lower()
    if suffix in (".json", ".gltf"):
        return _of_json(path)
    if suffix == ".xml" and b"<document" in start:
        return "metashape"
    if suffix == ".csv" and start.lower().startswith((b"#name", b"#cameras", b"name,x,y")):
        return "realityscan"
    if suffix == ".out" and start[:1] == b"#":
        return "bundler"
    return ENDS.get(suffix)


def _of_json(path: Path) -> FileKind | None:
    content = json_of(path)
    if isinstance(content, dict) and "frames" in content:
        return "nerfstudio"
    if isinstance(content, dict) and "asset" in content:
        return "gltf"
    first = content[0] if isinstance(content, list) and content else None
    return "opensfm" if isinstance(first, dict) and "shots" in first else None
