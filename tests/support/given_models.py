# SPDX-License-Identifier: Apache-2.0
"""The products of a run as another program would have left them: in a frame of their own, by a known similarity."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import laspy
import numpy as np
import pycolmap
import rasterio
from numpy.typing import ArrayLike, NDArray
from rasterio import Affine
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning
from rasterio.warp import Resampling, reproject
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity

Array = NDArray[np.float64]

TURN_DEG, SHRINK = 37.0, 1.3
COLOURS = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha)
LEVEL = Similarity(0.13, Rotation.from_euler("z", 130, degrees=True).as_matrix(), np.array([3.0, 4.0, 5.0]))
TILTED = Similarity(0.11, Rotation.from_euler("zyx", [130, 25, -40], degrees=True).as_matrix(), np.array([1.0, 2, 3]))


def turned_rasters(run: Path) -> tuple[NDArray[np.uint8], NDArray[np.float32], Affine]:
    """Orthophoto (4, n, n) and DSM (n, n) of a run on a turned, coarser grid, and the map coordinates of its pixels."""
    with rasterio.open(run / "ortho.tif") as ortho, rasterio.open(run / "dsm.tif") as dsm:
        pixel, size = ortho.transform.a * SHRINK, int(np.hypot(ortho.width, ortho.height) / SHRINK) + 2
        middle = ortho.transform @ (ortho.width / 2, ortho.height / 2)
        grid = Affine.translation(*middle) @ Affine.rotation(TURN_DEG) @ Affine.scale(pixel, -pixel)
        grid = grid @ Affine.translation(-size / 2, -size / 2)
        common = {"dst_transform": grid, "dst_crs": ortho.crs, "resampling": Resampling.bilinear}
        bands = np.zeros((4, size, size), np.uint8)
        for k in range(4):
            reproject(ortho.read(k + 1), bands[k], src_transform=ortho.transform, src_crs=ortho.crs, **common)
        heights = np.full((size, size), -9999, np.float32)
        nodata = {"src_nodata": -9999, "dst_nodata": -9999}
        reproject(dsm.read(1), heights, src_transform=dsm.transform, src_crs=dsm.crs, **nodata, **common)
    return bands, heights, grid


def write_raster(
    path: Path, bands: NDArray[np.generic], transform: Affine | None = None, crs: object = None, nodata: object = None
) -> Path:
    """A GeoTIFF (k, h, w), without a position where there is no transform."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        size = {"count": bands.shape[0], "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype}
        placed = {} if transform is None else {"transform": transform}
        with rasterio.open(path, "w", driver="GTiff", nodata=nodata, crs=crs, **size, **placed) as file:
            file.write(bands)
            if len(bands) == 4:
                file.colorinterp = COLOURS
    return path


def cloud_of(run: Path) -> tuple[Array, NDArray[np.uint8]]:
    """Map coordinates (n, 3) and colours (n, 3) of a run's cloud."""
    cloud = laspy.read(run / "pointcloud.laz")
    colours = np.column_stack([cloud[name] for name in ("red", "green", "blue")]) // 257
    return np.asarray(cloud.xyz), colours.astype(np.uint8)


def write_las(path: Path, points: ArrayLike, colours: NDArray[np.uint8] | None = None) -> Path:
    """A cloud without a CRS, with classes that count up."""
    xyz = np.asarray(points, np.float64)
    header = laspy.LasHeader(point_format=6 if colours is None else 7, version="1.4")
    header.scales, header.offsets = np.full(3, 1e-4), np.floor(xyz.mean(axis=0))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = xyz.T
    cloud.classification = np.arange(len(xyz)) % 7
    if colours is not None:
        cloud.red, cloud.green, cloud.blue = colours.astype(np.uint16).T * np.uint16(257)
    cloud.write(path)
    return path


def write_ply(
    path: Path,
    points: ArrayLike,
    colours: NDArray[np.uint8] | None = None,
    faces: Sequence[Sequence[int]] | None = None,
    kind: str = "f4",
) -> Path:
    """A binary PLY with vertices, and faces where they are given."""
    xyz = np.asarray(points)
    fields = [(axis, f"<{kind}") for axis in "xyz"]
    fields += [] if colours is None else [(name, "u1") for name in ("red", "green", "blue")]
    vertices = np.empty(len(xyz), fields)
    vertices["x"], vertices["y"], vertices["z"] = xyz.T
    if colours is not None:
        vertices["red"], vertices["green"], vertices["blue"] = colours.T
    typed = "double" if kind == "f8" else "float"
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(xyz)}"]
    header += [f"property {typed} {axis}" for axis in "xyz"]
    header += [] if colours is None else [f"property uchar {name}" for name in ("red", "green", "blue")]
    body = vertices.tobytes()
    if faces is not None:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        corners = np.empty(len(faces), [("n", "u1"), ("k", "<i4", 3)])
        corners["n"], corners["k"] = 3, np.asarray(faces)
        body += corners.tobytes()
    path.write_bytes("\n".join([*header, "end_header\n"]).encode() + body)
    return path


def moved_colmap(run: Path, folder: Path, move: Similarity = TILTED) -> Path:
    """The run's COLMAP model in another frame."""
    model = pycolmap.Reconstruction(str(run / "colmap" / "airborne_0"))
    model.transform(pycolmap.Sim3d(move.scale, pycolmap.Rotation3d(move.rotation), move.translation))
    folder.mkdir(parents=True)
    model.write(str(folder))
    return folder
