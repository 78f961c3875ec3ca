# SPDX-License-Identifier: Apache-2.0
"""One model of the files and folders that somebody names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from skymoor.errors import InputError
from skymoor.models.bundler import read_bundler
from skymoor.models.checks import readable
from skymoor.models.colmap import found_photos, read_colmap
from skymoor.models.detect import Found, find
from skymoor.models.given import GivenModel, Part, Plan
from skymoor.models.las import read_e57, read_las
from skymoor.models.mesh import read_gltf, read_obj
from skymoor.models.metashape import cameras_of_metashape
from skymoor.models.nerfstudio import read_nerfstudio
from skymoor.models.odm import read_odm
from skymoor.models.opensfm import read_opensfm
from skymoor.models.orthophoto import is_height_raster, read_orthophoto
from skymoor.models.ply import read_ply
from skymoor.models.posed import component_of_posed
from skymoor.models.realityscan import table_of
from skymoor.models.spz import read_spz

SURFACES: dict[str, Callable[[Path], GivenModel]] = {
    "las": read_las,
    "e57": read_e57,
    "ply": read_ply,
    "obj": read_obj,
    "gltf": read_gltf,
    "spz": read_spz,
}
"""Readers of files that hold a surface."""
CAMERAS: dict[str, Callable[[Path, Path | None], GivenModel]] = {
    "colmap": read_colmap,
    "nerfstudio": read_nerfstudio,
    "opensfm": read_opensfm,
    "bundler": read_bundler,
}
"""Readers of files that hold cameras and points."""


def read_model(paths: Sequence[Path], photos: Path | None = None) -> GivenModel:
    """The model of these files and folders, which share one coordinate system.

    Args:
        paths: a project's folder; or files, such as an orthophoto and its DSM, or cameras and their mesh.
        photos: folder of the photos that it was made from, where they are not beside it.

    Raises:
        InputError: a file is no model that is read, is damaged, or is not to be used; one line says which and why.
        BackendUnavailable: a library that reads it is not installed.
    """
    found = find(paths)
    projects = [one for one in found if one.kind == "odm"]
    if projects and len(found) > 1:
        raise InputError(f"{projects[0].path}: is a project with all its files; give it alone")
    if projects:
        with readable(projects[0].path, "project of ODM"):
            return read_odm(projects[0].path)
    cameras = [one for one in found if one.kind in CAMERAS]
    if len(cameras) > 1:
        raise InputError(f"{cameras[1].path}: is a second set of cameras; give one model at a time")
    models = [_read(one, photos) for one in cameras]
    # The largest is rendered; all others move with it.
    models += [_read(one, photos) for one in sorted(found, key=_size) if one.kind in SURFACES]
    rasters = [one.path for one in found if one.kind == "raster"]
    if rasters:
        with readable(rasters[0], "orthophoto"):
            models.append(_of_rasters(rasters))
    beside = [one for one in found if one.kind in ("metashape", "realityscan")]
    joined = _joined(models, beside)
    return _with_cameras(joined, beside, photos) if beside else joined


def _read(found: Found, photos: Path | None) -> GivenModel:
    with readable(found.path, f"model of the kind {found.kind}"):
        if found.kind in CAMERAS:
            return CAMERAS[found.kind](found.path, photos)
        return SURFACES[found.kind](found.path)


def _size(found: Found) -> float:
    return -found.path.stat().st_size


def _of_rasters(paths: Sequence[Path]) -> GivenModel:
    """An orthophoto and its DSM, whichever is named first."""
    heights = [path for path in paths if is_height_raster(path)]
    colours = [path for path in paths if path not in heights]
    if len(colours) != 1 or len(heights) > 1:
        raise InputError(f"{paths[0]}: give one orthophoto and at most one DSM of it")
    return read_orthophoto(colours[0], heights[0] if heights else None)


def _joined(models: Sequence[GivenModel], others: Sequence[Found]) -> GivenModel:
    """All files as one model: what the first has is rendered, and what is known of any holds for all."""
    if not models:
        raise InputError(f"{others[0].path}: has cameras and nothing to render; give the mesh or cloud as well")
    first = next((one for one in models if not one.sparse), models[0])
    cameras = next((one for one in models if one.component is not None), first)
    up = next((one.up for one in models if one.up is not None), None)
    return replace(
        first,
        component=cameras.component,
        photos=cameras.photos,
        parts=tuple(part for one in models for part in one.parts),
        up=first.up if first.up is not None else up,
        unit_m=next((one.unit_m for one in models if one.unit_m is not None), None),
        notes=tuple(note for one in models for note in one.notes),
    )


def _with_cameras(model: GivenModel, found: Sequence[Found], photos: Path | None) -> GivenModel:
    """A mesh or cloud with the cameras that were exported beside it."""
    if len(found) > 1 or model.component is not None:
        raise InputError(f"{found[-1].path}: is a second set of cameras; give one model at a time")
    path, surface = found[0].path, model.surface
    if isinstance(surface, Plan):
        raise InputError(f"{path}: give the mesh or cloud of the cameras, and not an orthophoto")
    if found[0].kind == "realityscan":
        table_of(path)
        return replace(model, parts=(*model.parts, Part("realityscan", path)))
    with readable(path, "file of Metashape's cameras"):
        cameras = cameras_of_metashape(path)
        files = found_photos([one.image for one in cameras], photos, path.parent) if photos is not None else {}
        component, _ = component_of_posed(cameras, surface.points, surface.colours, files, path)
    return replace(model, component=component, parts=(*model.parts, Part("metashape", path)))
