# SPDX-License-Identifier: Apache-2.0
"""The small world as files: photos without metadata, an orthophoto and a DSM of another day, site.toml, truth.csv."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from PIL import Image as PillowImage
from pyproj import Transformer

from flight import Flight, encoded
from scene import Scene
from skymoor.geo.frame import EnuFrame

Array = NDArray[np.float64]

FRAME = EnuFrame(52.4, 13.05, 87.0)
CRS = "EPSG:25833"  # UTM 33, whose grid is turned by 1.5 degrees against north here
PIXEL_M = 0.5
MIDDLE_M = (16.0, -8.0)  # of the reference in the site's frame: the photos are not in its middle
SIZE_PX = (340, 400)  # rows, columns
BIAS_M = (0.4, -0.3, 0.5)  # of the reference of the tests' site, east, north, up; its covariance allows for it
COVARIANCE = np.diag([0.5, 0.5, 0.8])


def write_site(
    folder: Path, flight: Flight, reference: Scene, *, bias_m: Sequence[float] = (0, 0, 0), seed: int = 11
) -> Path:
    """Write the site into `folder`; the reference is off by `bias_m` (east, north, up). Returns the site.toml."""
    rng = np.random.default_rng(seed)
    write_photos(folder, flight, rng)
    write_reference(folder / "reference", reference, bias_m=bias_m, seed=seed)
    site = folder / "site.toml"
    rows = ", ".join(str(row) for row in COVARIANCE.tolist())
    site.write_text(
        'name = "small world"\n[reference]\northo = "reference/ortho.tif"\ndsm = "reference/dsm.tif"\n'
        f'vertical_datum = "ellipsoid"\ncovariance = [{rows}]\n[airborne]\nimages = "airborne"\n'
    )
    return site


def write_photos(folder: Path, flight: Flight, rng: np.random.Generator) -> None:
    """JPEGs under names that say nothing about their order, and truth.csv."""
    (folder / "airborne").mkdir(parents=True)
    lla = FRAME.lla_from_enu([camera.centre for camera in flight.cameras])
    rows = []
    for number, camera, place in zip(rng.permutation(len(flight.cameras)), flight.cameras, lla, strict=True):
        name = f"airborne/IMG_{1000 + 17 * number}.jpg"
        PillowImage.fromarray(flight.images[camera.image]).save(folder / name, quality=95)
        rows.append([name, *(repr(float(value)) for value in place)])
    with (folder / "truth.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["image", "lat", "lon", "height"], *sorted(rows)])


def write_reference(folder: Path, scene: Scene, *, bias_m: Sequence[float] = (0, 0, 0), seed: int = 11) -> None:
    """ortho.tif: blurred, with another gamma and tint. dsm.tif: ellipsoidal heights with 0.15 m of noise, smoothed."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    east, north = _plan(4)
    bias_e, bias_n, bias_up = bias_m
    linear = scene.colours_from_above(east - bias_e, north - bias_n)
    sharp = cv2.resize(linear, SIZE_PX[::-1], interpolation=cv2.INTER_AREA)
    hazy = 0.06 + 0.8 * cv2.GaussianBlur(sharp, (0, 0), 0.65) * np.float32([0.92, 1.0, 1.08])
    noise = rng.normal(scale=2.0, size=hazy.shape)
    ortho = encoded(hazy, noise, gamma=1.7)
    east, north = _plan(1)
    up = scene.heights(east - bias_e, north - bias_n)
    up = cv2.GaussianBlur(up, (0, 0), 0.8) + cv2.GaussianBlur(rng.normal(scale=0.3, size=up.shape), (0, 0), 0.7)
    lla = FRAME.lla_from_enu(np.stack([east, north, up + bias_up], axis=-1).reshape(-1, 3))
    write_tif(folder / "ortho.tif", ortho.transpose(2, 0, 1))
    write_tif(folder / "dsm.tif", lla[:, 2].reshape(1, *SIZE_PX).astype(np.float32), nodata=-9999.0)


def write_tif(path: Path, bands: NDArray[np.generic], *, nodata: float | None = None, crs: str | None = CRS) -> None:
    """Bands (n, rows, columns) on the reference's pixels."""
    transform = rasterio.Affine(PIXEL_M, 0.0, _corner()[0], 0.0, -PIXEL_M, _corner()[1])
    layout = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2], "transform": transform}
    with rasterio.open(path, "w", driver="GTiff", dtype=bands.dtype, crs=crs, nodata=nodata, **layout) as file:
        file.write(bands)


def _corner() -> tuple[float, float]:
    """Easting and northing of the reference's north-western corner, whole metres."""
    lat, lon, _ = FRAME.lla_from_enu([*MIDDLE_M, 0.0])[0]
    easting, northing = Transformer.from_crs("EPSG:4326", CRS, always_xy=True).transform(lon, lat)
    return round(easting) - SIZE_PX[1] * PIXEL_M / 2, round(northing) + SIZE_PX[0] * PIXEL_M / 2


def _plan(subpixels: int) -> tuple[Array, Array]:
    """East and north in the site's frame of the centres of sub-pixels of the reference."""
    easting0, northing0 = _corner()
    step = PIXEL_M / subpixels
    x = easting0 + (np.arange(SIZE_PX[1] * subpixels) + 0.5) * step
    y = northing0 - (np.arange(SIZE_PX[0] * subpixels) + 0.5) * step
    easting, northing = np.meshgrid(x, y)
    lon, lat = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True).transform(easting, northing)
    enu = FRAME.enu_from_lla(lat.ravel(), lon.ravel(), FRAME.height_m)
    return enu[:, 0].reshape(easting.shape), enu[:, 1].reshape(easting.shape)
