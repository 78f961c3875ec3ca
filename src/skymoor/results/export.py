# SPDX-License-Identifier: Apache-2.0
"""A finished run in the words of other programs: one folder for each format, there whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from skymoor import __version__
from skymoor.engines.regular import content_told, regular
from skymoor.errors import BackendUnavailable, InputError
from skymoor.pipeline.option_parser import nearest
from skymoor.results.formats._registry import FORMATS
from skymoor.results.formats._source import Source
from skymoor.results.read import RUN_FIRST, Result
from skymoor.store import PRODUCTS, atomic_folder
from skymoor.types import Progress, no_progress

__all__ = ["FORMATS", "chosen_formats", "export"]

NOTE = "export.json"
WITHOUT_HEIGHTS = ("geojson", "gpkg", "geoparquet", "kml", "stac", "exif")
"""Formats that leave out heights that are not confirmed; the others cannot do without."""
CREDITS = ("licence", "credit", "date", "ortho_source", "dsm_source")
"""What a user of the export must know of the reference, as in summary.json."""
RELATIVE = "NOT_CONFIRMED: relative to the model's ground, or to a reference that contradicts the photos"


def export(
    result: Result,
    formats: Sequence[str],
    out: Path,
    note: Callable[[str], None],
    track: Callable[[str], Progress] = lambda _: no_progress,
) -> None:
    """Write each format into its folder below `out`; `note` is called with one line for each.

    Raises `InputError` for an unknown format, when nothing is registered, when a file of the run is missing, and where
    photos, the run's own products or foreign files would be harmed; `BackendUnavailable` where the library of a format
    is missing, which is left out of "all" instead.
    """
    chosen, everything = chosen_formats(formats), "all" in {one.strip() for text in formats for one in text.split(",")}
    _require_out(result, out)
    source = Source(result, out)
    if not source.rows:
        raise InputError(f"{result.folder}: nothing is registered, so there is nothing to export")
    for name in chosen:
        _require_ours(out / name)
    left_out = len(result.cameras) - len(source.rows)
    cameras = f"{len(source.rows)} cameras" + (f", {left_out} without a position left out" if left_out else "")
    for name in chosen:
        part = replace(source, target=out / name, notes=[], progress=track(name))
        try:
            atomic_folder(out / name, lambda folder, part=part, name=name: _fill(part, name, folder))  # type: ignore[misc]
        except BackendUnavailable as error:
            if not everything:
                raise
            note(f"{out / name}: left out: {error}")
            continue
        note("; ".join([f"{out / name}: {cameras}", *part.notes]))


def chosen_formats(names: Sequence[str]) -> list[str]:
    """The formats of a list such as "exif,kml" or "all". Raises `InputError` for one that is not known."""
    chosen = [name.strip() for text in names for name in text.split(",") if name.strip()]
    for name in chosen:
        if name != "all" and name not in FORMATS:
            raise InputError(f"--to {name}: no such format; {nearest(name, [*FORMATS, 'all'])}")
    if not chosen:
        raise InputError(f"--to: name a format; known: {', '.join([*FORMATS, 'all'])}")
    return list(FORMATS) if "all" in chosen else list(dict.fromkeys(chosen))


def _fill(source: Source, name: str, folder: Path) -> None:
    heights = _heights_of(source, name, folder)
    if source.without_heights:
        heights = "none where they are NOT_CONFIRMED" if name in WITHOUT_HEIGHTS else RELATIVE
        source.notes.append(f"heights: {heights}")
    files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    about: dict[str, object] = {"skymoor": __version__, "format": name, "heights": heights, "files": files}
    reference = {key: value for key in CREDITS if (value := source.result.summary["reference"].get(key))}
    about |= {"reference": reference} if reference else {}
    (folder / NOTE).write_text(json.dumps(about, indent=1), encoding="utf-8")


def _heights_of(source: Source, name: str, folder: Path) -> str:
    """What the format says of its heights, once it is written. Raises `InputError` where products are damaged."""
    with content_told(source.result.folder, f"cannot be written as {name}", RUN_FIRST):
        return FORMATS[name](source, folder)


def _require_out(result: Result, out: Path) -> None:
    where, run = out.resolve(), result.folder.resolve()
    sources = [source["path"] for one in result.summary["sets"] for source in one.get("sources", ())]
    former = [one["folder"] for one in result.summary["sets"] if "folder" in one]
    folders = [Path(path).resolve() for path in dict.fromkeys([*former, *sources])]
    for folder in folders:
        if folder.is_relative_to(where) or where.is_relative_to(folder):
            raise InputError(f"{out}: holds the photos of {folder} or lies in them; give another folder with --out")
    if run.is_relative_to(where) or (where.is_relative_to(run) and where.relative_to(run).parts[0] in PRODUCTS):
        raise InputError(f"{out}: holds the run itself or is one of its products; give another folder with --out")


def _require_ours(target: Path) -> None:
    """Refuse to replace a folder that holds anything which a former export did not write."""
    if not (target.exists() or target.is_symlink()):
        return
    try:
        known = {*json.loads(regular(target / NOTE).read_text(encoding="utf-8"))["files"], NOTE}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        known = set()
    for path in target.rglob("*") if target.is_dir() and not target.is_symlink() else [target]:
        if not path.is_dir() and (path == target or path.relative_to(target).as_posix() not in known):
            raise InputError(f"{path}: was not written by skymoor export and stays; give another folder with --out")
