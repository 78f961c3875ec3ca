# SPDX-License-Identifier: Apache-2.0
"""What reads files from outside, as `fuzz_readers.py` calls it: on a folder of files, of which some are damaged."""

from __future__ import annotations

import contextlib
import importlib
import json
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skymoor.errors import BackendUnavailable, DegenerateGeometry, InputError

LONGEST_LINE = 4000


@dataclass(frozen=True)
class Target:
    """A reader, the folder of its seed, and patterns of the files that are damaged."""

    seed: str
    files: tuple[str, ...]
    read: Callable[[Path], object]


def warm_up() -> None:
    """Import what the readers do, before memory is limited."""
    for name in ("api_models", "results.report.write", "results.export", "results.ask.question", "results.changes"):
        importlib.import_module(f"skymoor.{name}")
    for name in ("av", "pillow_heif", "pye57", "plyfile", "trimesh", "laspy", "pycolmap", "open3d", "scipy.spatial"):
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def examined(target: Target, folder: Path, damaged: Sequence[Path], *, shown: bool) -> dict[str, Any]:
    """Read, refused, or a finding."""
    try:
        target.read(folder)
    except (InputError, BackendUnavailable) as error:
        line = str(error)
        found: dict[str, Any] = {"outcome": "refused", "line": line[:300]}
        wrong = wrong_with(line, [*error.details] if isinstance(error, InputError) else [], folder)
        if wrong:
            found = {"outcome": "finding", "kind": wrong, "where": _innermost(error), "line": line[:2000]}
        return found
    except BaseException as error:
        if shown:
            traceback.print_exc()
        trace = "".join(traceback.format_exception(error))[-3000:]
        kind = "memory" if isinstance(error, MemoryError) else type(error).__name__
        return {"outcome": "finding", "kind": kind, "where": _innermost(error), "trace": trace}
    return {"outcome": "read"}


def wrong_with(line: str, details: Sequence[str], folder: Path) -> str:
    """What is wrong with a message."""
    names = {path.name for path in folder.rglob("*")} | {folder.name}
    if not any(name in text for text in (line, *details) for name in names):
        return "a message without a file"
    if "\n" in line:
        return "a message of several lines"
    return "a message without end" if len(line) > LONGEST_LINE else ""


def _innermost(error: BaseException) -> str:
    frames = [one for one in traceback.extract_tb(error.__traceback__) if "/skymoor/" in one.filename]
    return f"{frames[-1].filename.split('/skymoor/')[-1]}:{frames[-1].lineno}" if frames else "?"


def read_site(folder: Path) -> None:
    from skymoor.pipeline.options import Options
    from skymoor.pipeline.site import load_site, with_options

    site = load_site(folder / "site.toml")
    with_options(Options(), {**site.options, **site.bounds.options()}, "site.toml")
    assert np.isfinite(site.reference.covariance).all() or np.isnan(site.reference.covariance).all()


def read_controls(folder: Path) -> None:
    from skymoor.pipeline.control_files import read_control
    from skymoor.pipeline.control_places import Stated

    names = ("points.csv", "bars.csv", "gcp_list.txt", "geo.txt", "positions.csv")
    stated = Stated("EPSG:32617", "ellipsoid", 0.1, 0.2)
    found = read_control([folder / name for name in names], stated)
    assert all(abs(one.place.lat) <= 90 for one in found.positions)


def read_truth(folder: Path) -> None:
    from skymoor.results.tables import read_truth_csv

    assert read_truth_csv(folder / "truth.csv")


def reference_of(ortho: str, dsm: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        from skymoor.reference.raster import raster_files
        from skymoor.reference.read import read_reference

        raster_files(folder / ortho, folder / dsm)
        found = read_reference(folder / ortho, folder / dsm, "ellipsoid", np.eye(3), max_pixels=1e6)
        assert found.mask.any()

    return read


def read_photos(folder: Path) -> None:
    from skymoor.store import find_photos, has_metadata, open_photos

    has_metadata(find_photos([folder / "air"], folder).photos)
    photos = open_photos(folder / "air", folder)
    for name in photos.names:
        assert photos.read(name).ndim == 3


def read_videos(folder: Path) -> None:
    from skymoor.store import VideoOptions, count_frames, find_photos
    from skymoor.store.photos import write_frames

    for one in find_photos([folder], folder).videos:
        count_frames(one.path, VideoOptions())
        (folder / one.path.stem).mkdir()
        write_frames(one.path, folder / one.path.stem, VideoOptions())


def model_of(*names: str) -> Callable[[Path], None]:
    """A given model, read and rendered."""

    def read(folder: Path) -> None:
        from skymoor.model.views import RenderOptions
        from skymoor.models import read_model
        from skymoor.models.render import level_of, render_given

        given = read_model([folder / name for name in names] if names else [folder])
        if given.photos is not None:
            given.photos.read(given.photos.names[0])
        with contextlib.suppress(DegenerateGeometry):  # which refuses the model
            level, _ = level_of(given.surface, given.up, np.random.default_rng(0))
            render = render_given(given.surface, level, RenderOptions(max_px=128))
            assert render.rgb.shape[:2] == render.xyz.shape[:2]
            _move(given, folder / "placed")

    return read


def _move(given: Any, target: Path) -> None:
    """The files of a model to where a registration may put it."""
    from skymoor.geo import EnuFrame
    from skymoor.geometry import Similarity
    from skymoor.results.placed.move import move_part
    from skymoor.results.placed.placement import Placement

    target.mkdir()
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    enu_from_model = Similarity(2.0, turn, np.array([5.0, 6.0, 7.0]))
    placement = Placement.on(enu_from_model, EnuFrame(27.12, -81.0, 20.0), "EPSG:32617", "CONFIRMED", 0.0)
    for part in given.parts:
        move_part(part, target, placement)


def read_index(folder: Path) -> None:
    from skymoor.pipeline.feature_index import checked_index, reference_features
    from skymoor.reference.read import read_reference
    from skymoor.store._files import FileDigests

    reference = read_reference(folder / "ortho.tif", folder / "dsm.tif", "ellipsoid", np.eye(3))
    sha256 = FileDigests(folder / "files.json").sha256(folder / "ortho.tif")
    file, _ = checked_index(folder / "ortho.tif", sha256)
    reference_features(reference, folder / "ortho.tif", file)


def read_run(folder: Path) -> None:
    """As reports, exports and notebooks do."""
    from skymoor.results.read import Result

    result = Result.read(folder)
    repr(result)
    result.statistics  # noqa: B018
    for one in result.components:
        result.residuals(one)
        one.enu_from_sfm  # noqa: B018
    if (folder / "colmap/airborne_0").exists():
        result.model(result.components[0])
    result.scene_centres()
    result.to_dataframe()


def report_run(folder: Path) -> None:
    from skymoor.results.read import Result
    from skymoor.results.report.write import rewrite_report
    from skymoor.store import Store

    result = Result.read(folder)
    with Store.open(folder) as store:
        rewrite_report(result, store)


def evaluate_run(folder: Path) -> None:
    from skymoor.results.read import Result

    Result.read(folder).evaluate(folder / "truth.csv")


CAMERA_FORMATS = "colmap nerfstudio geojson gpkg geoparquet kml stac odm tum metashape realityscan opf"
SURFACE_FORMATS = "laz copc cog ply gltf 3dtiles"


def export_as(formats: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        from skymoor.results.export import export
        from skymoor.results.read import Result

        result = Result.read(folder)
        for name in formats.split():
            export(result, [name], folder / "exported", lambda _: None)

    return read


def view_run(folder: Path) -> None:
    from skymoor.results.read import Result
    from skymoor.results.viewer.scene import parts_of

    for _ in parts_of(Result.read(folder)):
        pass


def ask_run(folder: Path) -> None:
    from skymoor.results.ask.answer import Statement, answers_of, person_of
    from skymoor.results.ask.page import AskPage
    from skymoor.results.ask.question import questions_of
    from skymoor.results.read import Result

    answers_of(folder / "answers.json")
    path = folder / "summary.json"
    with contextlib.suppress(ValueError, KeyError, TypeError, IndexError, OSError, RecursionError, AttributeError):
        summary = json.loads(path.read_text())  # of the seed, which is registered
        summary["sets"][0]["components"][0]["status"] = "NOT_REGISTERED"
        path.unlink()
        path.write_text(json.dumps(summary))
    result = Result.read(folder)
    questions = questions_of(result)
    AskPage(result, questions).asking()
    person_of(result, questions[0], Statement(candidate=1))


def request_run(folder: Path) -> None:
    from skymoor.results.read import Result
    from skymoor.results.request import site_of_run

    site_of_run(Result.read(folder))


def on_earlier_run(folder: Path) -> None:
    from skymoor.pipeline.reference_files import earlier_run
    from skymoor.reference.read import read_reference

    files = earlier_run(folder)
    read_reference(*files.rasters, files.covariance, max_pixels=1e5)


def read_stages(folder: Path) -> None:
    from skymoor.store._cache import Corrupt, read_cache

    for path in sorted(folder.glob("stages/*.npz")):
        with contextlib.suppress(Corrupt, FileNotFoundError):
            read_cache(path)


def read_batch(folder: Path) -> None:
    from skymoor.batch.sites import SiteTask, outcome_of

    outcome_of(SiteTask("a", folder / "site.toml", folder), 0, 1.0, "", "")


RUN_FILES = ("summary.json", "summary.json", "*.json", "cameras.csv", "colmap/airborne_0/*.bin", "matches/*.npz")
RASTERS = ("ortho.tif", "dsm.tif", "confidence.tif", "pointcloud.laz")
TARGETS = {
    "site": Target("site", ("site.toml", "site.toml", "points.csv"), read_site),
    "control": Target("tables", ("points.csv", "bars.csv", "gcp_list.txt", "geo.txt", "positions.csv"), read_controls),
    "truth": Target("tables", ("truth.csv",), read_truth),
    "geotiff": Target("reference", ("*.tif",), reference_of("ortho.tif", "dsm.tif")),
    "vrt": Target("vrt", ("*.vrt", "*.vrt", "*.tif"), reference_of("ortho.vrt", "dsm.vrt")),
    "world_file": Target("world_file", ("ortho.*",), reference_of("ortho.png", "dsm.tif")),
    "photos": Target("photos", ("air/*",), read_photos),
    "video": Target("video", ("*.mp4", "*.avi"), read_videos),
    "index": Target("index", ("*.npz", "*.npz", "*.tif"), read_index),
    "orthophoto": Target("orthophoto", ("*.tif",), model_of("ortho.tif", "dsm.tif")),
    "odm": Target("odm", ("*/*",), model_of()),
    "colmap_binary": Target("colmap_binary", ("sparse/0/*", "sparse/0/*", "images/*"), model_of()),
    "colmap_text": Target("colmap_text", ("sparse/0/*",), model_of()),
    "nerfstudio": Target("nerfstudio", ("*.json", "*.json", "cloud.ply", "images/*"), model_of()),
    "opensfm": Target("opensfm", ("*.json",), model_of()),
    "bundler": Target("bundler", ("bundle*",), model_of("bundle.out")),
    "metashape": Target("metashape", ("*.xml", "*.xml", "*.ply"), model_of("m.ply", "cameras.xml")),
    "realityscan": Target("realityscan", ("*.csv",), model_of("m.ply", "cameras.csv")),
    **{
        name: Target(name, ("m.*", "*.png"), model_of(file))
        for name, file in {
            **dict.fromkeys(("ply", "ply_mesh", "ply_text", "ply_splat"), "m.ply"),
            **{"spz": "m.spz", "obj": "m.obj", "gltf": "m.gltf", "glb": "m.glb", "las": "m.las", "laz": "m.laz"},
            **{"copc": "m.copc.laz", "e57": "m.e57"},
        }.items()
    },
    "run": Target("run", RUN_FILES, read_run),
    "report": Target("run", (*RUN_FILES, "renders/*", *RASTERS), report_run),
    "evaluate": Target("run", ("summary.json", "cameras.csv", "truth.csv"), evaluate_run),
    "export": Target("run", (*RUN_FILES, *RASTERS), export_as(CAMERA_FORMATS)),
    "export_surfaces": Target("run", ("summary.json", *RASTERS), export_as(SURFACE_FORMATS)),
    "view": Target("run", (*RUN_FILES, *RASTERS), view_run),
    "ask": Target("run", ("*.json", "renders/*.npz", "cameras.csv"), ask_run),
    "request": Target("run", ("summary.json",), request_run),
    "earlier_run": Target("run", ("summary.json", "ortho.tif", "dsm.tif"), on_earlier_run),
    "stages": Target("run", ("stages/*",), read_stages),
    "batch": Target("run", ("summary.json",), read_batch),
}
