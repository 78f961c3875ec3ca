# SPDX-License-Identifier: Apache-2.0
"""Every stage is computed again when a line changes that it uses, and only then."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import skymoor
from skymoor.densify import SgmDepth, check_camera_poses, metric_scale_of_photos, relative_depths
from skymoor.ground.tiles import cascade, exhaustive
from skymoor.ground.walls import check_ground_poses, search_ground, walls_of_components
from skymoor.match import StructuralMatcher
from skymoor.model import MeshBuilder, NerfBuilder, render_nadir, render_obliques
from skymoor.orient import ground_points
from skymoor.pipeline.null_samples import null_samples
from skymoor.pipeline.register_best import register_best
from skymoor.pipeline.search import search_reference
from skymoor.reconstruct import reconstruct, with_focal
from skymoor.reference.read import read_reference
from skymoor.store import _closure, check_photos, import_closure
from skymoor.store._closure import defining_modules, fingerprint

PACKAGE = Path(skymoor.__file__).parent

STAGES: dict[str, Callable[..., object]] = {
    "photos": check_photos,
    "reference": read_reference,
    "reconstruct": reconstruct,
    "ground": ground_points,
    "refocus": with_focal,
    "depths": SgmDepth(),
    "pose_checks": check_camera_poses,
    "monocular": relative_depths,
    "model": MeshBuilder(),
    "model by a radiance field": NerfBuilder(),
    "nadir": render_nadir,
    "obliques": render_obliques,
    "search": search_reference,
    "decoys": null_samples,
    "register": register_best,
    "walls": walls_of_components,
    "metric": metric_scale_of_photos,
    "wall search": search_ground,
    "cascade": cascade,
    "exhaustive": exhaustive,
    "cameras": check_ground_poses,
}
USES = {
    "search": {
        "match.search",
        "match.channels",
        "match.correlate",
        "match.rasters",
        "types.rasters",
        "geometry.similarity",
    },
    "register": {"registration.refusal", "registration.covariance", "geometry.ransac", "match.align", "errors"},
    "reconstruct": {"reconstruct.mapping", "reconstruct.database", "engines.colmap", "types.photos"},
    "model by a radiance field": {"model.nerf.build", "model.nerf.hashgrid", "model.nerf.options"},
    "wall search": {
        "ground.walls.consensus",
        "ground.walls.facade_search",
        "match.structural",
        "registration.airborne",
    },
    "reference": {"reference.read", "reference.raster", "geo.datum"},
}
USES_NOT = {
    "search": {"match._roma", "match.decoys", "registration.airborne", "pipeline.airborne", "pipeline.options", "api"},
    "register": {"match._roma", "match.decoys", "reconstruct.mapping", "densify._sgm", "pipeline.options"},
    "reconstruct": {"match.search", "densify._sgm", "registration.airborne", "reconstruct._doppelgangers"},
    "depths": {"reconstruct.mapping", "densify._patchmatch", "match.search", "registration.covariance"},
    "reference": {"match.search", "types_of_nothing", "reconstruct.mapping"},
}


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A copy of the sources, which are read in the place of ours."""
    ignore = shutil.ignore_patterns("__pycache__")
    copy = Path(shutil.copytree(PACKAGE, tmp_path / "skymoor", ignore=ignore))
    monkeypatch.setattr(_closure, "FOLDER", copy)
    _closure.forget()
    yield copy
    monkeypatch.undo()
    _closure.forget()


def modules_of(copy: Path) -> dict[str, Path]:
    """All modules of the package by name."""
    found = {}
    for file in sorted(copy.rglob("*.py")):
        parts = file.relative_to(copy).with_suffix("").parts
        found[".".join(["skymoor", *(part for part in parts if part != "__init__")])] = file
    return found


def prints() -> dict[str, str]:
    """Of all stages, from the texts as they are now; what they import is read once, for no test here changes it."""
    _closure._text_digest.cache_clear()
    return {name: fingerprint(defining_modules(stage)) for name, stage in STAGES.items()}


def test_a_line_in_any_module_concerns_the_stages_that_use_it_and_no_others(copied: Path) -> None:
    uses = {name: import_closure(defining_modules(stage)) for name, stage in STAGES.items()}
    before, touched = prints(), 0
    for module, file in modules_of(copied).items():
        concerned = {name for name in STAGES if module in uses[name]}
        if module.startswith("skymoor.simulate") and not concerned:
            continue  # many, of which no stage knows
        text = file.read_bytes()
        file.write_bytes(text + b"# changed\n")
        after = prints()
        file.write_bytes(text)
        assert {name for name in STAGES if before[name] != after[name]} == concerned, module
        touched += bool(concerned)
    assert touched > 80
    assert prints() == before


@pytest.mark.parametrize("name", USES)
def test_what_a_stage_uses_is_found(name: str) -> None:
    found = import_closure(defining_modules(STAGES[name]))
    assert {f"skymoor.{module}" for module in USES[name]} <= found


@pytest.mark.parametrize("name", USES_NOT)
def test_what_a_stage_does_not_use_is_not(name: str) -> None:
    found = import_closure(defining_modules(STAGES[name]))
    assert found.isdisjoint({f"skymoor.{module}" for module in USES_NOT[name]})


def test_an_engine_among_the_inputs_counts() -> None:
    without = import_closure(defining_modules(register_best))
    with_engine = import_closure(defining_modules(register_best, [StructuralMatcher()]))
    assert "skymoor.match.structural" in with_engine - without


def test_names_of_packages_are_looked_through(copied: Path) -> None:
    (copied / "match" / "probe.py").write_text(
        "from typing import TYPE_CHECKING\n"
        "from skymoor.match import cyclic_matches as renamed\n"
        "import skymoor.geo.grid\n"
        "if TYPE_CHECKING:\n    from skymoor.match import RomaMatcher\n"
        "def late():\n    from skymoor.model.nerf import build\n"
    )
    found = import_closure(["skymoor.match.probe"])
    assert {"skymoor.match.cyclic", "skymoor.geo.grid", "skymoor.model.nerf.build"} <= found
    assert found.isdisjoint({"skymoor.match._roma", "skymoor", "skymoor.match"})
