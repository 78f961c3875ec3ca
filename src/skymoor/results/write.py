# SPDX-License-Identifier: Apache-2.0
"""Products of a run: summary, cameras, models, rasters and figures, all written by `Store`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skymoor import __version__
from skymoor.engines.colmap import write_colmap
from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.geometry import Similarity
from skymoor.match.overlay import warp_to_grid
from skymoor.pipeline.job import ComponentResult
from skymoor.pipeline.option_parser import option_values
from skymoor.pipeline.options import MatchOptions, Options
from skymoor.pipeline.photo_sets import or_too_few
from skymoor.pipeline.site import Site
from skymoor.results.accuracy import accuracy_of, figures_of, surface_accuracy
from skymoor.results.control import CONTROL_COLUMNS, control_summary, control_table
from skymoor.results.formats import (
    cameras_geojson,
    cameras_table,
    georeference,
    placed_cameras,
    unplaced_cameras,
)
from skymoor.results.model_rasters import write_rasters
from skymoor.results.read import STATISTICS
from skymoor.results.report.renderings import (
    confidence_figure,
    height_figure,
    match_figure,
    overlay_figure,
    residual_figure,
)
from skymoor.results.request import credits_of, first_photo, request_of
from skymoor.results.statistics import component_details, component_statistics, ellipses_of
from skymoor.results.survey import hypotheses_of, run_figures
from skymoor.results.tables import CAMERA_COLUMNS, CameraRow
from skymoor.store import Store, name_prefix, plain
from skymoor.types import Array, HeightStatus, Progress, Reference, no_progress

NO_COMPONENT = "no three photos have enough matches to be reconstructed together"
REGISTERED, NOT_REGISTERED = "REGISTERED", "NOT_REGISTERED"
SHOWN_AROUND, SHOWN_PX = 0.3, 40  # of the reference around the matches in pictures: share of their extent, and pixels


@dataclass(frozen=True, eq=False)
class SetResult:
    """A set of photos: name, folders and videos, names of images, results of its components, notes on its files."""

    name: str
    sources: Sequence[Path]
    images: Sequence[str]
    components: Sequence[ComponentResult]
    notes: Sequence[str] = ()


def write_products(
    sets: Sequence[SetResult],
    site: Site,
    reference: Reference,
    options: Options,
    seed: int,
    provenance: Mapping[str, Any],
    store: Store,
    *,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Write all products of a run; returns the summary. `provenance` is what the run was made from."""
    rows = [row for found in sets for row in camera_rows(found, reference)]
    # Of the cameras of a former run; the summary comes back last, so that none describes products of another run.
    for name in ("report.html", "report.pdf", "evaluation.json", STATISTICS, "summary.json"):
        store.remove(name)
    store.write_csv("cameras.csv", CAMERA_COLUMNS, cameras_table(rows))
    store.write_json("cameras.geojson", cameras_geojson(rows))
    _write_control(sets, site, store)
    _write_statistics(sets, reference, store)
    for found in sets:
        for k, item in enumerate(found.components):
            _write_component(f"{found.name}_{k}", item, reference, options.match, store)
    components = [item for found in sets for item in found.components]
    write_rasters(components, reference, options.match.min_height_confidence, store, progress)
    summary = {
        "skymoor": __version__,
        "site": site.name,
        **run_figures(site, reference, store.records),
        "seed": seed,
        "options": option_values(options),
        "reference": {
            "ortho": site.reference.ortho.resolve(),
            "dsm": dsm.resolve() if isinstance(dsm := site.reference.dsm, Path) else dsm,
            "vertical_datum": site.reference.vertical_datum,
            **credits_of(site),
            "area": site.bounds.area,
            "covariance_m2": reference.covariance if reference.accuracy_known else None,
            "accuracy": "stated" if reference.accuracy_known else "unknown",
            "pixel_m": reference.grid.pixel_m,
            "notes": list(reference.notes),
        },
        "enu_origin": georeference(reference.frame, Similarity.identity())["enu_origin"],
        "provenance": provenance,
        "request": request_of(site),
        "person": None if site.person is None else site.person.record,
        "sets": [_set_summary(found, reference, site.root) for found in sets],
        "stages": [asdict(record) for record in store.records],
    }
    store.write_json("summary.json", summary)
    return summary


def _write_control(sets: Sequence[SetResult], site: Site, store: Store) -> None:
    if site.control is None:
        store.remove("control.csv")
        return
    components = [(found.name, k, item.control) for found in sets for k, item in enumerate(found.components)]
    store.write_csv("control.csv", CONTROL_COLUMNS, control_table(components))


def _write_statistics(sets: Sequence[SetResult], reference: Reference, store: Store) -> None:
    """What grows with the number of photos stands beside the summary, in few lines."""
    details = {}
    for found in sets:
        for k, item in enumerate(found.components):
            images = [camera.image for camera in item.cameras_enu]
            accuracy = accuracy_of(item, reference) if images else None
            ellipses = {} if accuracy is None else ellipses_of(images, accuracy.total, accuracy.relative)
            details[f"{found.name}_{k}"] = component_details(item, ellipses)
    store.write_text(STATISTICS, json.dumps(plain(details), ensure_ascii=False, allow_nan=False) + "\n")


def camera_rows(found: SetResult, reference: Reference) -> list[CameraRow]:
    """Rows of cameras.csv. Components overlap: a photo counts in the first, largest one that holds it."""
    rows: list[CameraRow] = []
    seen: set[str] = set()
    for k, item in enumerate(found.components):
        mine: list[CameraRow] = []
        if item.registration.registered and item.component.cameras:
            figures = figures_of(accuracy_of(item, reference))
            mine = placed_cameras(found.name, k, item.cameras_enu, reference.frame, figures, _height_status(item))
        registered = {row.image for row in mine}
        others = [camera.image for camera in item.component.cameras if camera.image not in registered]
        mine += unplaced_cameras(found.name, k, others)
        rows += [row for row in mine if row.image not in seen]
        seen.update(row.image for row in mine)
    return rows + unplaced_cameras(found.name, None, [image for image in found.images if image not in seen])


def _height_status(item: ComponentResult) -> HeightStatus | None:
    return None if item.heights is None or not item.registration.registered else item.heights.status


def _set_summary(found: SetResult, reference: Reference, root: Path) -> dict[str, Any]:
    taken = {camera.image for item in found.components for camera in item.component.cameras}
    good = bool(found.components) and all(item.registration.registered for item in found.components)
    return {
        "set": found.name,
        "folder": found.sources[0].resolve(),
        "sources": [{"path": path.resolve(), "name": name_prefix(path, root).as_posix()} for path in found.sources],
        "notes": list(found.notes),
        "status": REGISTERED if good else NOT_REGISTERED,
        "reason": "" if found.components else or_too_few(NO_COMPONENT, len(found.images)),
        "n_images": len(found.images),
        "n_images_reconstructed": len(taken.intersection(found.images)),
        "components": [_component_summary(k, item, reference) for k, item in enumerate(found.components)],
    }


def _component_summary(index: int, item: ComponentResult, reference: Reference) -> dict[str, Any]:
    found = item.registration
    calibration = item.component.calibration
    summary: dict[str, Any] = {
        "component": index,
        "status": REGISTERED if found.registered else NOT_REGISTERED,
        "reason": found.reason,
        "criteria": [asdict(one) for one in found.criteria],
        "n_cameras": len(item.component.cameras),
        "n_lenses": len({camera.intrinsics for camera in item.component.cameras}),
        "n_matches": found.n_matches,
        "n_inliers": found.n_inliers,
        "inlier_ratio": found.inlier_ratio,
        "tilt_deg": found.tilt_deg,
        "rmse_m": found.rmse_m,
        "diagnostics": found.diagnostics,
        "reprojection_px": item.component.reprojection_px,
        "statistics": component_statistics(item),
        "calibration": calibration,
        "calibration_note": calibration_note(item),
        "gravity": item.gravity,
        "metric_scale": item.metric,
        "heights": _height_status(item),
        "height_verdict": item.heights,
        "height_scale": None if item.heights is None else item.heights.scale,
        "height_scale_sigma": None if item.heights is None else item.heights.scale_sigma,
        "lean_m_per_m": found.lean,
        "hypotheses": hypotheses_of(item, reference),
        "first_photo": first_photo(item),
        "contradicting_cameras": [check.image for check in item.pose_checks if check.contradicts],
        "control": control_summary(item.control),
    }
    if found.registered and found.enu_from_level is not None:
        ce90, le90, relative_ce90, relative_le90 = figures_of(accuracy_of(item, reference)).mean(axis=0).tolist()
        enu_from_sfm = found.enu_from_level @ item.level_from_sfm
        known = _height_status(item) != "NOT_CONFIRMED"
        summary |= georeference(reference.frame, enu_from_sfm, _height_status(item))
        summary |= {"predicted_ce90_m": ce90, "predicted_le90_m": le90 if known else None}
        summary |= {"predicted_relative_ce90_m": relative_ce90}
        summary |= {"predicted_relative_le90_m": relative_le90 if known else None}
        summary["surface_accuracy"] = surface_accuracy(item, reference)
        summary["scene_centre_enu"] = np.median(found.enu_from_level.apply(item.component.points), axis=0)
    return summary


def calibration_note(item: ComponentResult) -> str:
    """What a person must know about the focal length, empty where it is well known."""
    calibration = item.component.calibration
    if calibration is None or not calibration.uncertain or not item.scaled_by_focal_length:
        return ""
    half = 100 * LE90_PER_SIGMA * calibration.focal_sigma
    note = "Focal length and flying height are not separable in these photos"
    if calibration.relief_ratio is None:
        return f"{note}: camera heights are uncertain by ±{half:.0f} % (90 %)."
    change = 100 * (calibration.relief_ratio - 1)
    changed = f"the relief of the reference changed the focal length by {change:+.1f} %"
    return f"{note}; {changed} and leaves ±{half:.0f} % (90 %)."


def _write_component(
    name: str, item: ComponentResult, reference: Reference, options: MatchOptions, store: Store
) -> None:
    _write_pictures(name, item, reference, options, store)
    found, enu = item.registration, item.component_enu
    if enu is not None and enu.cameras and found.enu_from_level is not None:
        store.write_folder(f"colmap/{name}", lambda folder: write_colmap(enu, folder))
        transform = found.enu_from_level @ item.level_from_sfm
        store.write_json(
            f"colmap/{name}/georeference.json", georeference(reference.frame, transform, _height_status(item))
        )
    else:
        store.remove(f"colmap/{name}")


def _around(px: Array, reference: Reference) -> Reference:
    """The part of the reference around matches (n, 2) that pictures show: a large one is not drawn whole."""
    if not len(px):
        return reference
    plan = reference.grid.enu_from_px(px)
    margin = SHOWN_AROUND * float(np.ptp(plan, axis=0).max()) + SHOWN_PX * reference.grid.pixel_m
    return reference.part([*(plan.min(axis=0) - margin), *(plan.max(axis=0) + margin)])


def _write_pictures(
    name: str, item: ComponentResult, reference: Reference, options: MatchOptions, store: Store
) -> None:
    render, found = item.render, item.registration
    if item.walls is not None:
        store.write_png(f"matches/{name}_walls.png", item.walls)
    if item.plan is not None:
        store.write_png(f"matches/{name}_plan.png", item.plan)
    if render is None:
        return
    store.write_png(f"renders/{name}_nadir_rgb.png", render.rgb)
    store.write_png(f"renders/{name}_nadir_height.png", height_figure(render.xyz[..., 2]))
    store.write_png(f"renders/{name}_nadir_confidence.png", confidence_figure(render.confidence))
    store.write_npz(f"renders/{name}_nadir.npz", rgb=render.rgb, xyz=render.xyz, confidence=render.confidence)
    if item.matches is None:
        return
    pixels = item.matches.pixels
    part = _around(pixels.px_b, reference)
    shown = replace(pixels, px_b=part.grid.px_from_enu(reference.grid.enu_from_px(pixels.px_b)))
    figure = match_figure(render.rgb, part.rgb, shown, found.inliers)
    store.write_png(f"matches/{name}_matches.png", figure)
    inliers = np.zeros(len(pixels), bool) if found.inliers is None else found.inliers
    residuals = np.full((len(pixels), 3), np.nan) if found.residuals_m is None else found.residuals_m
    store.write_npz(
        f"matches/{name}.npz",
        px_render=pixels.px_a,
        px_reference=pixels.px_b,
        confidence=pixels.confidence,
        xyz_level=item.matches.xyz_level,
        xyz_enu=item.matches.xyz_enu,
        inliers=inliers,
        residuals_m=residuals,
    )
    if found.enu_from_level is None or found.residuals_m is None:
        return
    pixel_m = reference.grid.pixel_m
    warped, _ = warp_to_grid(render, found.enu_from_level, part.grid, options.min_height_confidence)
    store.write_png(f"matches/{name}_overlay.png", overlay_figure(warped, part.rgb, pixel_m=pixel_m))
    arrows = residual_figure(part.rgb, shown.px_b, found.residuals_m, inliers, pixel_m=pixel_m)
    store.write_png(f"matches/{name}_residuals.png", arrows)
