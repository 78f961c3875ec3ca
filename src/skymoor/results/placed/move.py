# SPDX-License-Identifier: Apache-2.0
"""The files of a registered model, rewritten where they belong."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from skymoor.engines.regular import content_told
from skymoor.models.given import GivenModel, Part, PartKind
from skymoor.pipeline.job import ComponentResult
from skymoor.results.placed.cameras import (
    move_bundler,
    move_colmap,
    move_metashape,
    move_nerfstudio,
    move_opensfm,
    move_realityscan,
)
from skymoor.results.placed.clouds import move_e57, move_las
from skymoor.results.placed.meshes import move_gltf, move_obj
from skymoor.results.placed.placement import Placement
from skymoor.results.placed.ply import move_ply, move_spz
from skymoor.results.placed.rasters import move_dsm, move_orthophoto
from skymoor.store import Store
from skymoor.types import Progress, Reference, no_progress

PLACED = "placed"
MOVERS: dict[PartKind, Callable[[Path, Path, Placement], list[str]]] = {
    "orthophoto": move_orthophoto,
    "dsm": move_dsm,
    "las": move_las,
    "ply": move_ply,
    "e57": move_e57,
    "obj": move_obj,
    "gltf": move_gltf,
    "spz": move_spz,
    "colmap": move_colmap,
    "nerfstudio": move_nerfstudio,
    "opensfm": move_opensfm,
    "bundler": move_bundler,
    "metashape": move_metashape,
    "realityscan": move_realityscan,
}


def move_part(part: Part, folder: Path, placement: Placement) -> list[str]:
    """Write one file of a model where it belongs; notes. Raises `InputError` for one that cannot be moved."""
    with content_told(part.path, "cannot be moved", "export it again"):  # of what was not needed to render it
        return MOVERS[part.kind](part.path, folder, placement.offset_by(part.offset))


def place_model(
    given: GivenModel,
    result: ComponentResult,
    reference: Reference,
    store: Store,
    progress: Progress = no_progress,
) -> list[str]:
    """Write the folder `placed` of the run: the model's files on Earth, and georeference.json for those in ENU metres.

    Returns notes on what could not be moved, one line each. A model that is not registered has no such folder.
    """
    found = result.registration
    if not found.registered or found.enu_from_level is None:
        store.remove(PLACED)
        return []
    enu_from_model = found.enu_from_level @ result.level_from_sfm
    ground = float(result.level_from_sfm.inverse().translation[2])
    heights = None if result.heights is None else result.heights.status
    placement = Placement.on(enu_from_model, reference.frame, reference.crs, heights, ground)
    notes: list[str] = []

    def fill(folder: Path) -> None:
        for done, part in enumerate(given.parts):
            progress(done, len(given.parts))
            notes.extend(move_part(part, folder, placement))
        (folder / "georeference.json").write_text(json.dumps(placement.described(), indent=2) + "\n", encoding="utf-8")

    store.write_folder(PLACED, fill)
    progress(len(given.parts), len(given.parts))
    if heights == "NOT_CONFIRMED":
        notes.append(f"{PLACED}: heights are not confirmed, so those of its files are relative")
    return notes
