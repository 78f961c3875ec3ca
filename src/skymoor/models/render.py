# SPDX-License-Identifier: Apache-2.0
"""A given surface from above: levelled, and rendered as the models of photos are."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.engines.raycast import RayCaster
from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import Similarity, fit_plane_ransac
from skymoor.model.views import DOWN, RenderOptions, nadir_view
from skymoor.models.given import Cloud, Mesh, Plan, Surface
from skymoor.types import Array, Array32, Image, Mask, Render, View

STATED_UP_SIGMA_DEG, FOUND_UP_SIGMA_DEG = 1.0, 3.0
"""Of up as a format states it, where the model may lie askew, and of a plane through rolling ground."""
GROUND_PERCENT = 20.0
SAMPLE = 20_000
CELLS = 256
"""Cells along a cloud, in which its occupied area is counted."""
NEAR_PX = 2
"""Distance over which pixels between points are interpolated."""
INTERPOLATED = 0.5
"""Their confidence."""
PLANE_SHARE = 0.01
ASYMMETRIC = 0.1


def level_of(surface: Surface, stated_up: Array | None, rng: np.random.Generator) -> tuple[Similarity, float]:
    """Level from model, with z up, the unit of the model and the ground near the origin; and the error of up, degrees.

    The level frame of an orthophoto has its rows along x. Raises `DegenerateGeometry` where up is not to be found.
    """
    if isinstance(surface, Plan):
        across = surface.model_from_px[:, 0] / np.linalg.norm(surface.model_from_px[:, 0])
        turn = np.array([[across[0], across[1], 0.0], [-across[1], across[0], 0.0], [0.0, 0.0, 1.0]])
        rows, columns = surface.mask.shape
        middle = surface.model_from_px @ [columns / 2, rows / 2, 1.0]
        ground = 0.0 if surface.heights is None else float(np.nanpercentile(surface.heights, GROUND_PERCENT))
        return Similarity(1.0, turn, -turn @ [*middle, ground]), STATED_UP_SIGMA_DEG
    points = surface.points[rng.permutation(len(surface.points))[:SAMPLE]]
    up, sigma = (
        (stated_up, STATED_UP_SIGMA_DEG) if stated_up is not None else (found_up(points, rng), FOUND_UP_SIGMA_DEG)
    )
    turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0].as_matrix()
    turned = points @ turn.T
    origin = [*np.median(turned[:, :2], axis=0), np.percentile(turned[:, 2], GROUND_PERCENT)]
    return Similarity(1.0, turn, -np.array(origin)), sigma


def found_up(points: Array, rng: np.random.Generator) -> Array:
    """Up (3,) of a landscape: the normal of its main plane, on the side on which more stands out of it.

    Houses and trees stand on the ground, and little hangs below it. Where neither side has more, up is towards +z, or
    +y where that is nearer. Raises `DegenerateGeometry` where the points determine no plane.
    """
    size = float(np.ptp(np.percentile(points, [2, 98], axis=0), axis=0).max())
    try:
        plane, _ = fit_plane_ransac(points, threshold=PLANE_SHARE * size, rng=rng)
    except TooFewMatches as error:
        raise DegenerateGeometry(f"up cannot be found: {error}") from error
    height = plane.height(points) / size
    above, below = int((height > PLANE_SHARE).sum()), int((height < -PLANE_SHARE).sum())
    if abs(above - below) > ASYMMETRIC * max(above + below, 1):
        return plane.normal if above > below else -plane.normal
    axis = 2 if abs(plane.normal[2]) >= abs(plane.normal[1]) else 1
    return plane.normal if plane.normal[axis] >= 0 else -plane.normal


def render_given(surface: Surface, level_from_model: Similarity, options: RenderOptions) -> Render:
    """The nadir render of the surface; grey shades of its relief where it has no colours.

    An orthophoto without heights is a plane: its heights mean nothing.
    """
    if isinstance(surface, Plan):
        return _of_plan(surface, level_from_model)
    if isinstance(surface, Mesh):
        return _of_mesh(surface, level_from_model, options)
    return _of_cloud(surface, level_from_model.apply(surface.points), options)


def _of_plan(plan: Plan, level_from_model: Similarity) -> Render:
    rows, columns = plan.mask.shape
    corner = level_from_model.apply([*(plan.model_from_px @ [0.0, 0.0, 1.0]), 0.0])
    pixel = float(np.linalg.norm(plan.model_from_px[:, 0]))
    view = View(DOWN, float(corner[0]), float(-corner[1]), pixel, (rows, columns))
    heights = np.zeros(plan.mask.shape) if plan.heights is None else plan.heights + level_from_model.translation[2]
    xyz = _positions(view, np.where(plan.mask, heights, np.nan))
    return Render(view, plan.rgb, xyz, np.isfinite(xyz[..., 2]).astype(np.float32))


def _positions(view: View, heights: Array | Array32) -> Array32:
    """xyz (h, w, 3) of heights (h, w) in a view straight down."""
    rows, columns = view.shape
    x = view.x0 + (np.arange(columns) + 0.5) * view.pixel
    y = -(view.y0 + (np.arange(rows) + 0.5) * view.pixel)
    return np.dstack([*np.meshgrid(x, y), heights]).astype(np.float32)


def _of_cloud(cloud: Cloud, points: Array, options: RenderOptions) -> Render:
    """The highest point in each pixel; pixels between points are interpolated, and less certain."""
    view = nadir_view(points, _spacing(points), options)
    rows, columns = view.shape
    u = np.floor((points[:, 0] - view.x0) / view.pixel).astype(np.int64)
    v = np.floor((-points[:, 1] - view.y0) / view.pixel).astype(np.int64)
    inside = np.flatnonzero((u >= 0) & (v >= 0) & (u < columns) & (v < rows))
    inside = inside[np.argsort(points[inside, 2], kind="stable")]
    flat = v[inside] * columns + u[inside]
    highest = np.full(rows * columns, np.nan, np.float32)
    highest[flat] = points[inside, 2]  # of several in one pixel the last one, which is the highest
    heights: Array32 = highest.reshape(rows, columns)
    known = np.isfinite(heights)
    rgb = np.zeros((rows * columns, 3), np.uint8)
    if cloud.colours is not None:
        rgb[flat] = cloud.colours[inside]
    rgb, heights = _interpolated(rgb.reshape(rows, columns, 3), heights, known)
    if cloud.colours is None:
        rgb = shaded(heights, view.pixel)
    confidence = np.where(known, 1.0, np.where(np.isfinite(heights), INTERPOLATED, 0.0))
    return Render(view, rgb, _positions(view, heights), confidence.astype(np.float32))


def _spacing(points: Array) -> float:
    """Side of a square with one point on average, where there are points."""
    low, high = np.percentile(points[:, :2], [1, 99], axis=0)
    cell = float((high - low).max()) / CELLS
    inside = ((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)
    cells = np.floor((points[inside, :2] - low) / cell).astype(np.int64) @ [1, 2 * CELLS]
    counts = np.unique(cells, return_counts=True)[1]
    full = len(counts) if np.median(counts) > 1 else CELLS * CELLS * float((high - low).min() / (high - low).max())
    return float(cell * np.sqrt(full / max(int(inside.sum()), 1)))


def _interpolated(rgb: Image, heights: Array32, known: Mask) -> tuple[Image, Array32]:
    """Colours and heights with means of the neighbours in pixels near known ones."""
    if known.all() or not known.any():
        return rgb, heights
    middle = np.float32(np.nanmedian(heights))
    layers = np.dstack([rgb, np.where(known, heights - middle, 0)]).astype(np.float32) * known[..., None]
    width = 2 * NEAR_PX + 1
    total = cv2.GaussianBlur(layers, (width, width), 0)
    weight = cv2.GaussianBlur(known.astype(np.float32), (width, width), 0)
    near = ~known & (weight > 1e-3)
    mean = total[near] / weight[near][:, None]
    rgb, heights = rgb.copy(), heights.copy()
    rgb[near], heights[near] = np.clip(mean[:, :3] + 0.5, 0, 255).astype(np.uint8), mean[:, 3] + middle
    return rgb, heights


def _of_mesh(mesh: Mesh, level_from_model: Similarity, options: RenderOptions) -> Render:
    vertices = level_from_model.apply(mesh.vertices).astype(np.float32)
    extent = float(np.ptp(np.percentile(vertices[:, :2], [0.3, 99.7], axis=0), axis=0).max())
    sides = np.linalg.norm(np.diff(vertices[mesh.triangles[:: max(1, len(mesh.triangles) // SAMPLE)]], axis=1), axis=2)
    pixel = extent / options.max_px if mesh.textures else float(np.median(sides)) / 2
    view = nadir_view(vertices.astype(np.float64), pixel, options)
    above = float(vertices[:, 2].max()) + extent
    origins = _positions(view, np.full(view.shape, above))
    down = np.broadcast_to(np.array([0.0, 0.0, -1.0], np.float32), origins.shape)
    distance, face, where, _ = RayCaster(vertices, mesh.triangles).hits(origins, down)
    hit = np.isfinite(distance) & (face >= 0)
    heights = np.where(hit, above - distance, np.nan).astype(np.float32)
    rgb = shaded(heights, view.pixel) if not mesh.coloured else np.zeros((*view.shape, 3), np.uint8)
    if mesh.coloured:
        rgb[hit] = _colours(mesh, face[hit], where[hit])
    return Render(view, rgb, _positions(view, heights), hit.astype(np.float32))


def _colours(mesh: Mesh, face: NDArray[np.int32], where: Array32) -> Image:
    """Colours (n, 3) at barycentric positions (n, 2) of faces."""
    weights = np.column_stack([1 - where.sum(axis=1), where])[..., None]
    if mesh.uv is None or mesh.face_texture is None or not mesh.textures:
        assert mesh.colours is not None
        mean = (mesh.colours[mesh.triangles[face]] * weights).sum(axis=1)
        return np.asarray(np.clip(mean + 0.5, 0, 255), np.uint8)
    uv = (mesh.uv[face] * weights).sum(axis=1) % 1.0
    found = np.full((len(face), 3), 128, np.uint8)
    for k, texture in enumerate(mesh.textures):
        mine = mesh.face_texture[face] == k
        rows, columns = texture.shape[:2]
        u = np.clip(uv[mine, 0] * columns, 0, columns - 1).astype(int)
        v = np.clip((1 - uv[mine, 1]) * rows, 0, rows - 1).astype(int)
        found[mine] = texture[v, u]
    return found


def shaded(heights: Array32, pixel: float) -> Image:
    """Grey (h, w, 3) of relief under light from the north-west; 128 where heights are unknown."""
    filled = np.where(np.isfinite(heights), heights, np.nanmedian(heights)).astype(np.float32)
    smooth = cv2.GaussianBlur(filled, (0, 0), 1.0)
    down, across = np.gradient(smooth / np.float32(pixel))
    light = (1 - (down + across) / np.sqrt(2)) / np.sqrt(1 + down**2 + across**2)
    grey = np.where(np.isfinite(heights), np.clip(128 * light, 0, 255), 128).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def mirrored(render: Render) -> Render:
    """The render of the mirror image of the model, in the same view."""
    view, xyz = render.view, render.xyz[:, ::-1].copy()
    xyz[..., 0] = 2 * view.x0 + view.shape[1] * view.pixel - xyz[..., 0]
    return Render(view, render.rgb[:, ::-1].copy(), xyz, render.confidence[:, ::-1].copy())
