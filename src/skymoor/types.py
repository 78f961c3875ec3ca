# SPDX-License-Identifier: Apache-2.0
"""The nouns that stages exchange: frozen, made of numpy arrays, free of paths.

Frames: `sfm` (arbitrary), `level` (sfm rotated so that z is up), `enu` (metres at the site), see `geo.frame`.
Pixels: u right, v down, the centre of the first pixel at (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from skymoor.geo import EnuFrame, Grid
from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.geometry import Intrinsics, Similarity

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


class Progress(Protocol):
    """Called with steps done and steps in all, and now and then with a line about how it goes."""

    def __call__(self, done: int, total: int, note: str = "", /) -> None: ...


def no_progress(done: int, total: int, note: str = "", /) -> None:
    """Ignore progress."""


@dataclass(frozen=True)
class Photos:
    """A folder's images: names relative to the site, sizes (width, height), and how to read one as (h, w, 3) RGB.

    `content` stands for all pixels where results are kept; without it they are read for that.
    """

    names: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    read: Callable[[str], Image]
    content: object = None

    def __len__(self) -> int:
        return len(self.names)

    def cache_key(self) -> object:
        """What results that are computed from the photos depend on."""
        return self.names, self.content if self.content is not None else [self.read(name) for name in self.names]


@dataclass(frozen=True, eq=False)
class Camera:
    """A posed image. `cam_from_world` has scale 1; camera axes are x right, y down, z forward."""

    image: str
    intrinsics: Intrinsics
    cam_from_world: Similarity

    @cached_property
    def centre(self) -> Array:
        """Projection centre in the world frame, (3,)."""
        return self.cam_from_world.inverse().translation

    def transformed(self, target_from_world: Similarity) -> Camera:
        """Express the camera in another frame; the similarity's scale moves the centre only."""
        rotation = self.cam_from_world.rotation @ target_from_world.rotation.T
        centre = target_from_world.apply(self.centre)
        return replace(self, cam_from_world=Similarity(1.0, rotation, -rotation @ centre))


@dataclass(frozen=True)
class Calibration:
    """How well the photos alone fix the focal length.

    `focal_low_ratio` and `focal_high_ratio` bound the focal lengths, relative to the estimate, that explain the
    photos about as well (profile of the bundle adjustment's cost). They count as an interval of 90 %: on real and
    simulated blocks the error was a tenth to nine tenths of its half. `uncertain` says that they are wide.
    """

    shared_intrinsics: bool
    focal_px: float
    focal_sigma_ratio: float
    focal_low_ratio: float
    focal_high_ratio: float
    uncertain: bool
    relief_ratio: float | None = None  # by which the reference's relief has changed the focal length

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length."""
        return max((self.focal_high_ratio - self.focal_low_ratio) / 2 / LE90_PER_SIGMA, self.focal_sigma_ratio, 0.0)

    def narrowed(self, ratio: float, sigma: float) -> Calibration:
        """With what another source says: that the focal length is `ratio` times the estimate, up to `sigma` of it.

        The estimate stays: its deviation from `ratio` counts as an error.
        """
        total = float(np.hypot(sigma, ratio - 1))
        return replace(
            self,
            focal_sigma_ratio=total,
            focal_low_ratio=1 - LE90_PER_SIGMA * total,
            focal_high_ratio=1 + LE90_PER_SIGMA * total,
        )


@dataclass(frozen=True, eq=False)
class Component:
    """One connected reconstruction: cameras, points (n, 3), colours (n, 3), and the observations that tie them.

    Observation k says that camera `obs_camera[k]` sees point `obs_point[k]` at pixel `obs_px[k]`. The camera centres'
    covariances (n cameras, 3, 3), where they are known, are of the shape alone, whatever the frame.
    """

    cameras: tuple[Camera, ...]
    points: Array
    colours: Image
    obs_camera: NDArray[np.int32]
    obs_point: NDArray[np.int32]
    obs_px: Array
    reprojection_px: float
    calibration: Calibration | None = None
    centre_covariances: Array | None = None

    @property
    def centres(self) -> Array:
        """Projection centres, (n cameras, 3)."""
        return np.array([camera.centre for camera in self.cameras])

    def of_cameras(self, keep: Mask) -> Component:
        """With those cameras alone of which `keep` (n cameras,) is true, and what they see; all points stay."""
        seen = keep[self.obs_camera]
        return replace(
            self,
            cameras=tuple(camera for camera, kept in zip(self.cameras, keep, strict=True) if kept),
            obs_camera=(np.cumsum(keep) - 1)[self.obs_camera[seen]].astype(np.int32),
            obs_point=self.obs_point[seen],
            obs_px=self.obs_px[seen],
            centre_covariances=None if self.centre_covariances is None else self.centre_covariances[keep],
        )

    def transformed(self, target_from_world: Similarity) -> Component:
        """Express the component in another frame."""
        cameras = tuple(camera.transformed(target_from_world) for camera in self.cameras)
        covariances = self.centre_covariances
        if covariances is not None:
            turn = target_from_world.scale * target_from_world.rotation
            covariances = turn @ covariances @ turn.T
        points = target_from_world.apply(self.points)
        return replace(self, cameras=cameras, points=points, centre_covariances=covariances)


@dataclass(frozen=True, eq=False)
class Gravity:
    """Up in the component's frame, with its estimated error and how it was found."""

    up: Array
    sigma_deg: float
    plane_height: float  # of the ground plane along `up`, in component units
    camera_height: float  # median height of the cameras above that plane, in component units
    method: str
    disagreement_deg: float  # between the ground plane's normal and the cameras' horizon


@dataclass(frozen=True, eq=False)
class DepthMap:
    """z-depth of an undistorted pinhole view, NaN where unknown, with its standard deviation, same unit."""

    camera: Camera  # intrinsics without distortion, of the depth map's own size
    depth: Array32
    sigma: Array32
    n_views: NDArray[np.uint8]  # how many stereo partners agree
    rgb: Image

    def points(self, *, max_sigma_ratio: float = 0.02, step: int = 1) -> tuple[Array32, Image]:
        """Points (n, 3) in the camera's world frame, and colours (n, 3), of every `step`-th pixel.

        Pixels count whose depth is more certain than `max_sigma_ratio` of it.
        """
        i = self.camera.intrinsics
        rows, columns = np.arange(step // 2, i.height, step), np.arange(step // 2, i.width, step)
        depth, sigma = self.depth[np.ix_(rows, columns)], self.sigma[np.ix_(rows, columns)]
        with np.errstate(invalid="ignore"):
            row, column = np.nonzero(sigma < max_sigma_ratio * depth)
        rays = i.rays(np.column_stack([columns[column], rows[row]]) + 0.5)
        points = self.camera.cam_from_world.inverse().apply(rays * depth[row, column][:, None])
        return points.astype(np.float32), self.rgb[rows[row], columns[column]]


@dataclass(frozen=True, eq=False)
class View:
    """An orthographic camera: `view_from_level` turns level coordinates to x right, y down, z along the rays.

    Pixel (u, v) is the ray x = x0 + u * pixel, y = y0 + v * pixel of the view frame.
    """

    view_from_level: Array  # (3, 3) rotation
    x0: float
    y0: float
    pixel: float  # size of a pixel in level units
    shape: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Render:
    """What a view shows: rgb (h, w, 3), xyz_level (h, w, 3) NaN where nothing is, and confidence in [0, 1]."""

    view: View
    rgb: Image
    xyz: Array32
    confidence: Array32


@dataclass(frozen=True, eq=False)
class Raster:
    """What a dense matcher is given: rgb (h, w, 3), mask of pixels that mean something, and heights where known.

    `height` is in units of a pixel (so that slopes are comparable), NaN where unknown; a matcher may ignore it.
    """

    rgb: Image
    mask: Mask
    height: Array32 | None = None


@dataclass(frozen=True, eq=False)
class Warp:
    """A dense flow both ways. `b_from_a` (ha, wa, 2): the pixel of b for each pixel of a; confidence in [0, 1]."""

    b_from_a: Array32
    confidence_a: Array32
    a_from_b: Array32
    confidence_b: Array32


@dataclass(frozen=True, eq=False)
class Matches2D:
    """Pairs of pixels (n, 2) with confidence (n,)."""

    px_a: Array
    px_b: Array
    confidence: Array

    def __len__(self) -> int:
        return len(self.px_a)

    def take(self, index: NDArray[np.intp] | Mask) -> Matches2D:
        """Keep some of the matches."""
        return Matches2D(self.px_a[index], self.px_b[index], self.confidence[index])


@dataclass(frozen=True, eq=False)
class Matches3D:
    """Pairs of points (n, 3): in the model's level frame and in ENU metres; with the pixels they came from."""

    xyz_level: Array
    xyz_enu: Array
    pixels: Matches2D

    def __len__(self) -> int:
        return len(self.xyz_level)

    def take(self, index: NDArray[np.intp] | Mask) -> Matches3D:
        """Keep some of the matches."""
        return Matches3D(self.xyz_level[index], self.xyz_enu[index], self.pixels.take(index))

    @classmethod
    def joined(cls, parts: Sequence[Matches3D]) -> Matches3D:
        """All matches of all parts; their pixels are each part's own."""
        none = np.zeros((0, 3))
        pixels = Matches2D(
            np.concatenate([none[:, :2], *(part.pixels.px_a for part in parts)]),
            np.concatenate([none[:, :2], *(part.pixels.px_b for part in parts)]),
            np.concatenate([none[:, 0], *(part.pixels.confidence for part in parts)]),
        )
        xyz_level = np.concatenate([none, *(part.xyz_level for part in parts)])
        return cls(xyz_level, np.concatenate([none, *(part.xyz_enu for part in parts)]), pixels)


COARSER = 1.4  # times the orthophoto's pixel, from which on detail is said to be lost


@dataclass(frozen=True, eq=False)
class Reference:
    """Orthophoto and DSM resampled to one north-up ENU grid.

    `rgb` (h, w, 3) uint8 and `height` (h, w) float32, ENU up in metres, NaN where unknown; `mask` is where the
    orthophoto has data; `covariance` (3, 3) m^2 is the reference's own absolute accuracy, east-north-up. `dsm_pixel_m`
    is infinite where heights come from no raster: all are NaN then, or one constant above the datum. `notes` are
    sentences about how the files were read, one line each.
    """

    frame: EnuFrame
    grid: Grid
    rgb: Image
    mask: Mask
    height: Array32
    covariance: Array
    dsm_pixel_m: float
    crs: str = "EPSG:4326"  # of the orthophoto, for products
    notes: tuple[str, ...] = ()
    finest_m: float = 0.0  # pixel of the orthophoto itself, where the grid is coarser

    @property
    def accuracy_known(self) -> bool:
        """Whether somebody states how accurate it is; if not, `covariance` is NaN."""
        return not np.isnan(self.covariance).any()

    @property
    def detail_lost(self) -> bool:
        """Whether the grid is much coarser than the orthophoto, because of its area."""
        return 0 < self.finest_m < self.grid.pixel_m / COARSER

    def part(self, bounds_m: Sequence[float]) -> Reference:
        """What lies between west, south, east and north in metres, at least a pixel, on whole pixels."""
        (left, bottom), (right, top) = self.grid.px_from_enu(np.reshape(bounds_m, (2, 2)))
        rows, columns = self.grid.shape
        u, v = int(np.clip(left, 0, columns - 1)), int(np.clip(top, 0, rows - 1))
        window = np.s_[v : int(np.clip(np.ceil(bottom), v + 1, rows)), u : int(np.clip(np.ceil(right), u + 1, columns))]
        east, north = self.grid.enu_from_px([float(u), float(v)]).tolist()
        mask = self.mask[window]
        grid = Grid(east, north, self.grid.pixel_m, (mask.shape[0], mask.shape[1]))
        return replace(self, grid=grid, rgb=self.rgb[window], mask=mask, height=self.height[window], notes=())

    @cached_property
    def has_heights(self) -> bool:
        """Whether any height is known."""
        return bool(np.isfinite(self.height).any())

    @property
    def has_relief(self) -> bool:
        """Whether heights come from an elevation model, and not from one number or nothing."""
        return self.has_heights and bool(np.isfinite(self.dsm_pixel_m))


@dataclass(frozen=True)
class Criterion:
    """A value that was compared with a limit to decide about a registration.

    `kind` is a key of `registration.criterion_kinds.KINDS`, which says what it means, on which side of the limit it
    passes, and what helps where it fails.
    """

    kind: str
    value: float
    limit: float
    passed: bool


HeightStatus = Literal["CONFIRMED", "OFFSET_ONLY", "NOT_CONFIRMED"]


@dataclass(frozen=True)
class HeightVerdict:
    """What the reference says of a model's heights, apart from its position on the map.

    CONFIRMED: its relief is the model's. OFFSET_ONLY: heights hang on the reference's mean height alone. NOT_CONFIRMED:
    the reference has no heights, or such that contradict the photos; the model's heights are relative then.

    Attributes:
        status: one of these.
        reason: why it is not more; also what else is to be known.
        scale, scale_sigma: the reference's relief divided by the model's, and its standard deviation.
        spread_m: robust standard deviation of the difference of both.
        resolution_m: finest detail of the elevation model, estimated.
    """

    status: HeightStatus
    reason: str = ""
    scale: float | None = None
    scale_sigma: float | None = None
    spread_m: float | None = None
    resolution_m: float | None = None


@dataclass(frozen=True, eq=False)
class Registration:
    """Where a model is on Earth, or why that is not known.

    `criteria` are all that were checked, in the order in which they take precedence; `reason` is that of the first that
    failed. A refusal before any was checked has a reason and no criteria.
    """

    registered: bool
    reason: str
    enu_from_level: Similarity | None
    n_matches: int = 0
    n_inliers: int = 0
    tilt_deg: float = float("nan")
    rmse_m: float = float("nan")
    covariance: Array | None = None  # (7, 7) of scale (log), rotation (rad), translation at the inliers' centroid (m)
    centroid_enu: Array | None = None
    inliers: Mask | None = None
    residuals_m: Array | None = None  # (n, 3) east-north-up of every match
    diagnostics: dict[str, float] = field(default_factory=dict)
    criteria: tuple[Criterion, ...] = ()
    heights: HeightVerdict | None = None  # of models that are registered on the map
    absolute: Array | None = None  # (8, 8) after control: of the same and of the log focal length, without a reference
    lean: tuple[float, float] | None = None  # of raised surfaces in the orthophoto, metres east and north per metre up

    @property
    def inlier_ratio(self) -> float:
        """Share of the matches that the transform explains."""
        return self.n_inliers / self.n_matches if self.n_matches else 0.0
