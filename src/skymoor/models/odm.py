# SPDX-License-Identifier: Apache-2.0
"""A project folder of OpenDroneMap (or WebODM's all.zip, unpacked)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from skymoor.errors import InputError
from skymoor.models.given import Z_UP, GivenModel, Mesh, Part
from skymoor.models.las import read_las
from skymoor.models.mesh import read_obj
from skymoor.models.orthophoto import read_orthophoto

ORTHO = ("odm_orthophoto/odm_orthophoto.tif", "odm_orthophoto/odm_orthophoto.original.tif")
DSM = ("odm_dem/dsm.tif", "odm_dem/dsm.original.tif")
CLOUD = ("odm_georeferencing/odm_georeferenced_model.laz", "odm_georeferencing/odm_georeferenced_model.las")
MESH = ("odm_texturing/odm_textured_model_geo.obj", "odm_texturing/odm_textured_model.obj")
COORDS = "odm_georeferencing/coords.txt"


def read_odm(path: Path) -> GivenModel:
    """Orthophoto, DSM, cloud and mesh of a project, as far as they are there; the first of them is rendered.

    The mesh has the offset of coords.txt. Raises `InputError` where there is none of them, or one cannot be used.
    """
    ortho, dsm, cloud, mesh = (_first(path, names) for names in (ORTHO, DSM, CLOUD, MESH))
    models = [] if ortho is None else [read_orthophoto(ortho, dsm)]
    models += [] if cloud is None else [read_las(cloud)]
    if mesh is not None:
        x, y = _offset(path / COORDS)
        found = read_obj(mesh)
        assert isinstance(found.surface, Mesh)
        moved = replace(found.surface, vertices=found.surface.vertices + [x, y, 0.0])
        models.append(replace(found, surface=moved, parts=(Part("obj", mesh, (x, y, 0.0)),)))
    if not models:
        raise InputError(f"{path}: has neither orthophoto nor cloud nor mesh of ODM; run ODM to its end")
    notes = (
        (f"{path}: ODM's cameras have a frame of their own and are not moved",) if (path / "opensfm").is_dir() else ()
    )
    unit_m = next((one.unit_m for one in models if one.unit_m is not None), None)
    parts = tuple(part for one in models for part in one.parts)
    return replace(models[0], name=path.name, parts=parts, up=Z_UP, unit_m=unit_m, notes=notes)


def _first(path: Path, names: tuple[str, ...]) -> Path | None:
    return next((path / name for name in names if (path / name).is_file()), None)


def _offset(path: Path) -> tuple[float, float]:
    """Of the mesh, on the second line."""
    if not path.is_file():
        return 0.0, 0.0
    try:
        x, y = path.read_text(encoding="utf-8").splitlines()[1].split()[:2]
        return float(x), float(y)
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: has no offset on its second line ({error}); run ODM again") from error
