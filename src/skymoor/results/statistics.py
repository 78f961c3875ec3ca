# SPDX-License-Identifier: Apache-2.0
"""Figures of a reconstruction: tie points, reprojection errors, ground sampling distance, overlap and match graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, triu
from scipy.spatial import cKDTree

from skymoor.geo import Grid
from skymoor.geo.accuracy import CE90_PER_SIGMA
from skymoor.pipeline.job import ComponentResult
from skymoor.results.lenses import lens_figures, lens_residuals
from skymoor.types import Array, Component

STRONGEST = 6  # neighbours of each photo in the match graph: lines to all would hide each other
OVERLAP_CELLS = 80  # along the longer side of the overlap map
OVERLAP_PERCENT = 1.0  # of the tie points outside the map on each side: single wrong ones are far away
STEREO = 2  # photos that must show a place for it to be reconstructed


def component_statistics(item: ComponentResult) -> dict[str, Any]:
    """For summary.json: how many tie points, how well they fit, how fine the photos are, and the lenses.

    `gsd_m` and `area_m2` need a scale and are None where the component is not registered; of ground components the
    area is None too, since what they show stands upright.
    """
    component = item.component
    lengths = np.bincount(component.obs_point, minlength=len(component.points))
    errors = reprojection_errors(component)
    photos = photo_figures(component, scale_of(item))
    gsd = [one["gsd_m"] for one in photos if one["gsd_m"] is not None]
    counts = overlap_of(item)
    return {
        "n_tie_points": int((lengths > 0).sum()),
        "n_observations": len(component.obs_point),
        "mean_track_length": float(lengths[lengths > 0].mean()) if lengths.any() else None,
        "mean_reprojection_px": _mean(errors),
        "rms_reprojection_px": float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else None,
        "gsd_m": float(np.median(gsd)) if gsd else None,
        "area_m2": None if counts is None else covered_m2(*counts),
        "lenses": lens_figures(component),
    }


def component_details(item: ComponentResult, ellipses: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """For statistics.json: a row for each photo, match graph, residuals over the image of each lens, overlap map.

    `photos` are in the order of the component, with the `ellipses` of those that are registered. `shared_points` are
    rows of two numbers of photos and how many tie points both see. `overlap` has its north-western corner and cell in
    ENU metres, and how many photos show each cell, row by row from north to south; None where it is not known.
    """
    counts = overlap_of(item)
    nothing = dict.fromkeys(("ellipse_90", "relative_ellipse_90", "covariance_m2", "relative_covariance_m2"))
    photos = photo_figures(item.component, scale_of(item))
    return {
        "photos": [one | ellipses.get(one["image"], nothing) for one in photos],
        "shared_points": shared_points(item.component),
        "residuals": lens_residuals(item.component, image_residuals(item.component)),
        "overlap": None if counts is None else _plain_overlap(*counts),
    }


def image_residuals(component: Component) -> Array:
    """Observed minus projected pixels (n, 2) of every observation; NaN where a point cannot be projected."""
    residuals = np.full((len(component.obs_px), 2), np.nan)
    for camera, own in zip(component.cameras, _observations(component), strict=True):
        xyz_cam = camera.cam_from_world.apply(component.points[component.obs_point[own]])
        residuals[own] = component.obs_px[own] - camera.intrinsics.px_from_cam(xyz_cam)
    return residuals


def reprojection_errors(component: Component) -> Array:
    """Lengths (n,) of the residuals in pixels."""
    return np.asarray(np.linalg.norm(image_residuals(component), axis=1))


def photo_figures(component: Component, scale: float | None) -> list[dict[str, Any]]:
    """Of each photo: its tie points, their mean reprojection error in pixels, and the ground sampling distance.

    The latter is the median depth of its tie points over the focal length, in metres by `scale` metres per unit of
    the component; None without a scale.
    """
    errors, rows = reprojection_errors(component), []
    for camera, own in zip(component.cameras, _observations(component), strict=True):
        depths = camera.cam_from_world.apply(component.points[component.obs_point[own]])[:, 2]
        focal = (camera.intrinsics.fx + camera.intrinsics.fy) / 2
        gsd = None if scale is None or not len(depths) else scale * float(np.median(depths)) / focal
        figures = {"n_points": len(own), "reprojection_px": _mean(errors[own]), "gsd_m": gsd}
        rows.append({"image": camera.image} | figures)
    return rows


def shared_points(component: Component, strongest: int = STRONGEST) -> list[list[int]]:
    """Pairs of photos as [first, second, tie points that both see].

    A pair counts if it is among the `strongest` of either photo.
    """
    shape = (len(component.cameras), max(1, len(component.points)))
    sees = csr_matrix(
        (np.ones(len(component.obs_camera), np.int64), (component.obs_camera, component.obs_point)), shape
    )
    sees.data[:] = 1  # a point counts once in a photo
    pairs = triu(sees @ sees.T, 1).tocoo()
    kept = np.zeros(len(pairs.data), bool)
    for k in range(len(component.cameras)):
        (own,) = np.nonzero((pairs.row == k) | (pairs.col == k))
        kept[own[np.argsort(-pairs.data[own], kind="stable")[:strongest]]] = True
    return [
        [int(a), int(b), int(n)] for a, b, n in zip(pairs.row[kept], pairs.col[kept], pairs.data[kept], strict=True)
    ]


def overlap_of(item: ComponentResult) -> tuple[Grid, NDArray[np.int32]] | None:
    """How many photos show each cell of the ground; None for ground components and where none is registered."""
    enu = item.component_enu
    if enu is None or not enu.cameras or not len(enu.obs_point) or not item.scaled_by_focal_length:
        return None
    return overlap(enu)


def overlap(component_enu: Component, cells: int = OVERLAP_CELLS) -> tuple[Grid, NDArray[np.int32]]:
    """How many photos show each cell of the ground where there are tie points, whether or not something is in front.

    The height of a cell is that of the nearest tie point.
    """
    points = component_enu.points[np.unique(component_enu.obs_point)]
    low, high = np.percentile(points[:, :2], [OVERLAP_PERCENT, 100 - OVERLAP_PERCENT], axis=0)
    cell = max(float((high - low).max()) / cells, 1e-6)
    columns, rows = (max(1, int(np.ceil(side / cell))) for side in (high - low).tolist())
    grid = Grid(float(low[0]), float(high[1]), cell, (rows, columns))
    plan = grid.centres().reshape(-1, 2)
    xyz = np.column_stack([plan, points[cKDTree(points[:, :2]).query(plan)[1], 2]])
    counts = np.zeros(len(xyz), np.int32)
    for camera in component_enu.cameras:
        lens = camera.intrinsics
        with np.errstate(invalid="ignore"):
            px = lens.px_from_cam(camera.cam_from_world.apply(xyz))
            counts += ((px >= 0) & (px <= [lens.width, lens.height])).all(axis=1)
    return grid, counts.reshape(grid.shape)


def covered_m2(grid: Grid, counts: NDArray[np.int32]) -> float:
    """Area that at least two photos show."""
    return float((counts >= STEREO).sum()) * grid.pixel_m**2


def error_ellipse(covariance: Array) -> list[float] | None:
    """Semi-axes in metres and azimuth of the longer one, degrees from 0 to 180, of the ellipse that holds 90 %.

    `covariance` (2, 2) or larger is in m^2, east first; None where it is not known.
    """
    plan = np.asarray(covariance, dtype=np.float64)[:2, :2]
    if not np.isfinite(plan).all():
        return None
    variances, axes = np.linalg.eigh((plan + plan.T) / 2)
    minor, major = CE90_PER_SIGMA * np.sqrt(np.maximum(variances, 0))
    azimuth = float(np.degrees(np.arctan2(axes[0, 1], axes[1, 1])) % 180)
    return [float(major), float(minor), azimuth]


def ellipses_of(images: Sequence[str], total: Array, relative: Array) -> dict[str, dict[str, Any]]:
    """Covariances (n, 3, 3) of photos by name and their ellipses, on Earth and relative to the reference."""
    return {
        image: {
            "ellipse_90": error_ellipse(a),
            "relative_ellipse_90": error_ellipse(b),
            "covariance_m2": a.tolist() if np.isfinite(a).all() else None,
            "relative_covariance_m2": b.tolist() if np.isfinite(b).all() else None,
        }
        for image, a, b in zip(images, total, relative, strict=True)
    }


def scale_of(item: ComponentResult) -> float | None:
    """Metres per unit of the component; None where it is not registered."""
    found = item.registration
    return found.enu_from_level.scale if found.registered and found.enu_from_level is not None else None


def _observations(component: Component) -> list[NDArray[np.intp]]:
    """The numbers of the observations of each camera."""
    order = np.argsort(component.obs_camera, kind="stable")
    ends = np.searchsorted(component.obs_camera[order], np.arange(1, len(component.cameras)))
    return np.split(order, ends) if component.cameras else []


def _plain_overlap(grid: Grid, counts: NDArray[np.int32]) -> dict[str, Any]:
    place = {"west": grid.east0, "north": grid.north0, "cell_m": grid.pixel_m}
    return place | {"counts": counts.tolist()}


def _mean(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None
