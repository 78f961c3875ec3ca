# SPDX-License-Identifier: Apache-2.0
"""Facades: the orthophoto of a wall, and the transforms between two of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Similarity
from skymoor.ground.wall_planes import Wall
from skymoor.types import Array, Array32, Camera, DepthMap, Mask, Raster

Hidden = Callable[[Camera, Array], Mask]
"""Which of the points (h, w, 3) a camera does not see, (h, w)."""

OUTSIDE = -1.0
"""In place of a depth, beyond the border of a photo."""

NO_DEPTH_DOWN_M = 0.5
"""Photos without depth are used this far below a wall at most: there the ground begins."""


@dataclass(frozen=True)
class FacadeOptions:
    """Orthophotos of walls; lengths are in the unit of the frame of wall and cameras, metres by default.

    Attributes:
        tolerance_m: a photo shows a point of the wall unless its depth there is further than this from the wall.
        no_depth_weight: of photos without a depth there: windows have none, and yet distinguish facades.
        no_depth_margin_m: how far beyond the wall such photos count, sideways and up.
        margin_m: by how much the orthophoto is larger than the wall, to all sides.
        min_cosine: of the angle between ray and wall's normal; flatter views are not used.
        photos: that contribute to a wall, those with the finest pixels.
        blend: photos that are averaged at a point.
        max_px: long side of an orthophoto.
    """

    tolerance_m: float = 0.6
    no_depth_weight: float = 0.5
    no_depth_margin_m: float = 0.0
    margin_m: float = 1.0
    min_cosine: float = 0.12
    photos: int = 8
    blend: int = 4
    max_px: int = 1200


@dataclass(frozen=True, eq=False)
class Facade:
    """Orthophoto of a wall: columns run to the right as seen from outside, rows downwards.

    The first pixel's upper left corner is at `s0` along the wall and height `z1`. `detail_m` is the size of the photos'
    pixels on the wall, along it and upwards: photos from above are foreshortened.
    """

    wall: Wall
    raster: Raster
    pixel_m: float
    s0: float
    z1: float
    detail_m: tuple[float, float] = (float("nan"), float("nan"))

    def xyz(self, px: Array) -> Array:
        """Points (n, 3) of the wall's plane at pixels (n, 2)."""
        s, z = self.s0 + px[:, 0] * self.pixel_m, self.z1 - px[:, 1] * self.pixel_m
        plan = self.wall.normal * self.wall.offset + s[:, None] * self.wall.right
        return np.column_stack([plan, z])

    @property
    def axes(self) -> tuple[Array, Array]:
        """Positions along the wall of the middles of columns, and heights of those of rows."""
        rows, columns = self.raster.mask.shape
        along = self.s0 + (np.arange(columns) + 0.5) * self.pixel_m
        up = self.z1 - (np.arange(rows) + 0.5) * self.pixel_m
        return np.asarray(along), np.asarray(up)

    @property
    def points(self) -> Array:
        """Middles of the pixels in space (h, w, 3)."""
        u, v = np.meshgrid(*(np.arange(n) + 0.5 for n in self.raster.mask.shape[::-1]))
        return self.xyz(np.column_stack([u.ravel(), v.ravel()])).reshape(*u.shape, 3)

    def px(self, xyz: Array) -> Array:
        """Pixels (n, 2) of points (n, 3), projected onto the plane."""
        return np.column_stack(
            [(xyz[:, :2] @ self.wall.right - self.s0) / self.pixel_m, (self.z1 - xyz[:, 2]) / self.pixel_m]
        )


@dataclass(frozen=True, eq=False)
class _Layer:
    rgb: Array32
    shown: Array32  # weight; 0 where something else is visible


def facade_of(
    wall: Wall,
    maps: Sequence[DepthMap],
    pixel_m: float,
    options: FacadeOptions | None = None,
    *,
    hidden: Hidden | None = None,
) -> Facade:
    """Orthophoto of a wall from the photos in front of it with the finest pixels; empty without any.

    Args:
        wall: in the frame of the maps' cameras.
        maps: undistorted photos with depth.
        pixel_m: size of a pixel, in the unit of the maps' frame; larger where the orthophoto would exceed `max_px`.
        options: see there.
        hidden: which points a camera does not see, where not the depths of its photo tell that.
    """
    options = options or FacadeOptions()
    return facade_from(wall, _sharpest(wall, maps, options), pixel_m, options, hidden=hidden)


def facade_from(
    wall: Wall,
    photos: Sequence[DepthMap],
    pixel_m: float,
    options: FacadeOptions | None = None,
    *,
    hidden: Hidden | None = None,
) -> Facade:
    """As `facade_of`, from all of the photos, that of the finest pixels first."""
    options = options or FacadeOptions()
    margin = options.margin_m
    width, height = wall.s1 - wall.s0 + 2 * margin, wall.z1 - wall.z0 + 2 * margin
    pixel_m = max(pixel_m, max(width, height) / options.max_px)
    shape = (int(np.ceil(height / pixel_m)), int(np.ceil(width / pixel_m)))
    empty = Raster(np.zeros((*shape, 3), np.uint8), np.zeros(shape, dtype=bool))
    facade = Facade(wall, empty, pixel_m, wall.s0 - margin, wall.z1 + margin)
    if not photos:
        return facade
    layers = [_layer(facade, depth_map, options, hidden) for depth_map in photos]
    weights = np.stack([layer.shown for layer in layers])
    largest = _largest(weights, options.blend)
    weights = np.where(weights >= np.maximum(largest[-1], largest[0] / 2), weights, 0)
    total = weights.sum(axis=0)
    rgb = sum(w[..., None] * layer.rgb for w, layer in zip(weights, layers, strict=True))
    colours = np.clip(rgb / np.maximum(total, 1e-12)[..., None], 0, 255).astype(np.uint8)
    shown = int(np.argmax([layer.shown.sum() for layer in layers]))
    return replace(facade, raster=Raster(colours, total > 0), detail_m=_detail(wall, photos[shown]))


def set_back(facade: Facade, distance: float) -> Facade:
    """The same picture on a plane that lies so much further inwards."""
    return replace(facade, wall=replace(facade.wall, offset=facade.wall.offset - distance))


def similarity_between(a: Facade, b: Facade, b_from_a: Array) -> Similarity:
    """The level similarity of space that maps facade a onto facade b as the (2, 3) affine maps their pixels.

    Raises `DegenerateGeometry` when the affine has no positive scale.
    """
    scale = float(np.sqrt(abs(np.linalg.det(b_from_a[:, :2])))) * b.pixel_m / a.pixel_m
    if not scale > 0:
        raise DegenerateGeometry("two facades cannot be related at scale zero")
    cos, sin = b.wall.normal @ a.wall.normal, b.wall.normal[1] * a.wall.normal[0] - b.wall.normal[0] * a.wall.normal[1]
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    middle = np.array([[a.raster.mask.shape[1] / 2, a.raster.mask.shape[0] / 2]])
    source = a.xyz(middle)[0]
    target = b.xyz(middle @ b_from_a[:, :2].T + b_from_a[:, 2])[0]
    return Similarity(scale, rotation, target - scale * rotation @ source)


def affine_between(a: Facade, b: Facade, b_from_a: Similarity) -> Array:
    """Pixels of b from pixels of a, (2, 3), for a similarity of space that maps a nearly parallel to b."""
    h, w = a.raster.mask.shape
    corners = np.array([[0.0, 0.0], [w, 0.0], [0.0, h]])
    px = b.px(b_from_a.apply(a.xyz(corners)))
    linear = np.column_stack([(px[1] - px[0]) / w, (px[2] - px[0]) / h])
    return np.column_stack([linear, px[0]])


def _sharpest(wall: Wall, maps: Sequence[DepthMap], options: FacadeOptions) -> list[DepthMap]:
    """Photos in front of the wall that hold some of it, those with the finest pixels on it first."""
    targets = np.concatenate([wall.corners, [wall.centre]])
    normal = np.array([*wall.normal, 0.0])
    found: list[tuple[float, DepthMap]] = []
    for depth_map in maps:
        camera = depth_map.camera
        rays = camera.centre - targets
        distance = np.linalg.norm(rays, axis=1)
        cosine = rays @ normal / distance
        if cosine.max() < options.min_cosine or (camera.centre @ normal) - wall.offset <= 0:
            continue
        i = camera.intrinsics
        xyz_cam = camera.cam_from_world.apply(targets)
        px = xyz_cam[:, :2] / np.maximum(xyz_cam[:, 2:], 1e-6) * [i.fx, i.fy] + [i.cx, i.cy]
        # A long wall may cross the image with all its corners outside: the box around them decides.
        front = xyz_cam[:, 2] > 0
        if not front.any() or (
            front.all() and ((px.max(axis=0) < 0).any() or (px.min(axis=0) > [i.width, i.height]).any())
        ):
            continue
        found.append((float(np.median(cosine * i.fx / distance)), depth_map))
    return [depth_map for _, depth_map in sorted(found, key=lambda pair: -pair[0])[: options.photos]]


def _detail(wall: Wall, depth_map: DepthMap) -> tuple[float, float]:
    """Size of a photo's pixels at the middle of a wall, along it and upwards."""
    ray = depth_map.camera.centre - wall.centre
    distance = float(np.linalg.norm(ray))
    pixel = distance / depth_map.camera.intrinsics.fx
    across = np.hypot(ray[:2] @ wall.normal, ray[2]) / distance
    level = abs(float(ray[:2] @ wall.normal)) / max(float(np.hypot(ray[:2] @ wall.normal, ray[2])), 1e-9)
    return pixel / max(across, 1e-3), pixel / max(level, 1e-3)


def _within(facade: Facade, margin: float) -> Mask:
    """Which pixels of a facade belong to its wall even where no depth says so."""
    along, up = facade.axes
    wall = facade.wall
    inside_along = (along >= wall.s0 - margin) & (along <= wall.s1 + margin)
    inside_up = (up >= wall.z0 - min(margin, NO_DEPTH_DOWN_M)) & (up <= wall.z1 + margin)
    return np.asarray(inside_up[:, None] & inside_along)


def _largest(weights: Array32, count: int) -> list[Array32]:
    """The `count` largest (h, w) of the weights (n, h, w) at each pixel, the largest first; a sort takes ten times as
    long.
    """
    found: list[Array32] = []
    for weight in weights:
        for k, larger in enumerate(found):
            found[k], weight = np.maximum(larger, weight), np.minimum(larger, weight)
        if len(found) < count:
            found.append(weight)
    return found


def _layer(facade: Facade, depth_map: DepthMap, options: FacadeOptions, hidden: Hidden | None) -> _Layer:
    """Colours and weights of one photo on the wall."""
    camera, i, wall = depth_map.camera, depth_map.camera.intrinsics, facade.wall
    # Most of the work of a search: a plane and its picture differ by a homography, which OpenCV samples at once.
    along, up = facade.axes
    rotation, origin = camera.cam_from_world.rotation, camera.cam_from_world.apply(wall.point(0.0, 0.0)[None])[0]
    across = rotation[:, :2] @ wall.right
    first = origin + across * along[0] + rotation[:, 2] * up[0]
    lens = np.array([[i.fx, 0.0, i.cx - 0.5], [0.0, i.fy, i.cy - 0.5], [0.0, 0.0, 1.0]])
    px_from_facade = lens @ np.column_stack([across * facade.pixel_m, -rotation[:, 2] * facade.pixel_m, first])
    size = (len(along), len(up))
    linear, nearest = (cv2.WARP_INVERSE_MAP | flag for flag in (cv2.INTER_LINEAR, cv2.INTER_NEAREST))
    rgb = cv2.warpPerspective(
        depth_map.rgb, px_from_facade, size, flags=linear, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float32)
    depth = cv2.warpPerspective(depth_map.depth, px_from_facade, size, flags=nearest, borderValue=OUTSIDE)
    z = (origin[2] + rotation[2, 2] * up).astype(np.float32)[:, None] + (across[2] * along).astype(np.float32)
    centre = camera.centre
    height = float(centre[:2] @ wall.normal) - wall.offset
    of_row, of_column = (up - centre[2]) ** 2, (along - centre[:2] @ wall.right) ** 2
    squared = of_row.astype(np.float32)[:, None] + (of_column + height**2).astype(np.float32)
    # The cosine to the power of 1.5 times the pixels per length.
    weight = np.float32(abs(height) ** 1.5 * i.fx) / (squared * np.sqrt(np.sqrt(squared)))
    weight *= (z > 1e-6) & (depth != OUTSIDE) & (squared < np.float32((max(height, 0.0) / options.min_cosine) ** 2))
    if hidden is not None:
        return _Layer(rgb, np.where(hidden(camera, facade.points), 0, weight).astype(np.float32))
    # Distance of the observed surface behind the plane of the wall, along its normal, times the plane's depth.
    behind = np.abs(depth - z) * np.float32(abs(height))
    seen = np.where(behind < np.float32(options.tolerance_m) * z, weight, 0)
    within = _within(facade, options.no_depth_margin_m)
    shown = np.where(within & np.isnan(depth), np.float32(options.no_depth_weight) * weight, seen)
    return _Layer(rgb, shown.astype(np.float32))
