# SPDX-License-Identifier: Apache-2.0
"""What a satellite leaves behind: an orthophoto and a surface model in UTM, of another day and a little off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import rasterio
from numpy.typing import ArrayLike, NDArray
from pyproj import Transformer
from rasterio import Affine

from skymoor.geo import EnuFrame, ce90_m
from skymoor.geo.accuracy import LE90_PER_SIGMA
from skymoor.simulate.capture.footing import ground_up
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import Label, stream
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.plan import dates_of, place_of
from skymoor.simulate.world import World
from skymoor.types import Image

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

# CE90 and LE90 in metres of the references; of the first three as in the paper's results.
ACCURACY_M = {
    "office-park": (2.13, 3.82),
    "industrial": (3.11, 3.71),
    "flooded": (2.85, 3.84),
    "hillside": (2.70, 3.80),
    "old-houses": (2.70, 3.80),
}
ABOVE_M = 150.0  # where rays start, over the ground
TILE_M = 60.0  # between the corners of a tile, map projections are bilinear to a hundredth of a millimetre
SAMPLES = 3  # rays per pixel of the orthophoto, per side
NODATA = -9999.0
BLUNDER_SHARE = 0.0015  # of the DSM's area
BLUNDER_RADII_M = (1.0, 2.2)


@dataclass(frozen=True, eq=False)
class MapSheet:
    """A north-up square of a map: easting and northing of its north-western corner, pixel size, pixels per side."""

    crs: str
    easting_m: float
    northing_m: float
    pixel_m: float
    side: int

    @property
    def transform(self) -> Affine:
        """Map coordinates of pixels, as GDAL has them."""
        return Affine(self.pixel_m, 0.0, self.easting_m, 0.0, -self.pixel_m, self.northing_m)

    def tiles(self, frame: EnuFrame, samples: int) -> Iterator[tuple[slice, slice, Array]]:
        """Rows, columns, and the exact plan positions in the frame (rows * samples, columns * samples, 2)."""
        size = max(int(TILE_M / self.pixel_m), 1)
        lonlat_from_map = Transformer.from_crs(self.crs, "EPSG:4326", always_xy=True)
        for top in range(0, self.side, size):
            for left in range(0, self.side, size):
                rows, columns = slice(top, min(top + size, self.side)), slice(left, min(left + size, self.side))
                easting = self.easting_m + self.pixel_m * np.array([columns.start, columns.stop])
                northing = self.northing_m - self.pixel_m * np.array([rows.start, rows.stop])
                x, y = np.meshgrid(easting, northing)
                lon, lat = lonlat_from_map.transform(x.ravel(), y.ravel())
                corners = frame.enu_from_lla(lat, lon, frame.height_m)[:, :2].reshape(2, 2, 2)
                v, u = (
                    (np.arange((side.stop - side.start) * samples) + 0.5) / ((side.stop - side.start) * samples)
                    for side in (rows, columns)
                )
                west = corners[0, 0] + v[:, None] * (corners[1, 0] - corners[0, 0])
                east = corners[0, 1] + v[:, None] * (corners[1, 1] - corners[0, 1])
                yield rows, columns, west[:, None] + u[:, None] * (east - west)[:, None]


@dataclass(frozen=True, eq=False)
class SimulatedReference:
    """Orthophoto (h, w, 3), and DSM (h, w) of ellipsoidal heights with NaN where unknown; each on its sheet."""

    ortho: Image
    ortho_sheet: MapSheet
    dsm: Array32
    dsm_sheet: MapSheet

    def write_ortho(self, path: Path) -> None:
        """As a GeoTIFF of three bands."""
        _write(path, self.ortho.transpose(2, 0, 1), self.ortho_sheet, photometric="RGB")

    def write_dsm(self, path: Path) -> None:
        """As a GeoTIFF of metres."""
        heights = np.where(np.isfinite(self.dsm), self.dsm, np.float32(NODATA))
        _write(path, heights[None], self.dsm_sheet, nodata=NODATA, predictor=3)


def covariance_of(options: SiteOptions) -> Array:
    """Covariance (3, 3) in m^2 of the reference, east-north-up, correlated, with the CE90 and LE90 of the options."""
    rng = stream(options.key, "covariance")
    ce90, le90 = ACCURACY_M[options.preset]
    ce90, le90 = options.ce90_m or ce90, options.le90_m or le90
    turn, ratio = rng.uniform(0, np.pi), rng.uniform(0.6, 0.95)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    plan = axes @ np.diag([1.0, ratio**2]) @ axes.T
    plan *= (ce90 / ce90_m(plan)) ** 2
    # An error along the line of sight is one of place and of height at once.
    sigma_up = le90 / LE90_PER_SIGMA
    across = rng.uniform(-0.3, 0.3, 2) * np.sqrt(np.diag(plan)) * sigma_up
    return np.block([[plan, across[:, None]], [across[None], np.array([[sigma_up**2]])]])


def draw_bias(covariance: ArrayLike, rng: np.random.Generator) -> Array:
    """An error (3,) in metres, east-north-up, of that covariance (3, 3)."""
    bias: Array = np.linalg.cholesky(np.asarray(covariance, dtype=np.float64)) @ rng.normal(size=3)
    return bias


def make_reference(world: World, scene: Scene, bias_m: Array, rng: np.random.Generator) -> SimulatedReference:
    """The orthophoto and DSM of a scene; what stands at p is shown at p + `bias_m` (3,), in both alike."""
    options, frame = world.options, place_of(world.options)
    room = max(min(0.08 * options.reference_width_m, world.plan.extent_m - 0.55 * options.reference_width_m), 0.0)
    middle = rng.uniform(-room, room, 2)
    ortho_sheet = _sheet(frame, middle, options.reference_width_m, options.ortho_pixel_m)
    dsm_sheet = _sheet(frame, middle, options.reference_width_m, options.dsm_pixel_m)
    ortho = _ortho(world, scene, frame, ortho_sheet, bias_m, rng)
    dsm = _dsm(world, _in_leaf(world, scene), frame, dsm_sheet, bias_m, rng)
    return SimulatedReference(ortho, ortho_sheet, dsm, dsm_sheet)


def _in_leaf(world: World, scene: Scene) -> Scene:
    """The scene that the DSM shows: heights come from pairs of several dates, and large crowns are in all of them."""
    date = dates_of(world.options).satellite
    if world.options.preset != "old-houses" or date.season != "winter":
        return scene
    return world.scene(replace(date, season="summer"))


def _sheet(frame: EnuFrame, middle: Array, width_m: float, pixel_m: float) -> MapSheet:
    crs = frame.utm_zone
    lat, lon, _ = frame.lla_from_enu([*middle, 0.0])[0]
    easting, northing = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
    side = max(round(width_m / pixel_m), 1)
    return MapSheet(crs, round(easting - width_m / 2), round(northing + width_m / 2), pixel_m, side)


def _ortho(
    world: World, scene: Scene, frame: EnuFrame, sheet: MapSheet, bias_m: Array, rng: np.random.Generator
) -> Image:
    """Rectified to the ground: with an oblique line of sight what stands on it leans away from the satellite."""
    azimuth, lean = rng.uniform(0, 2 * np.pi), np.tan(np.radians(world.options.off_nadir_deg))
    to_satellite = np.array([np.sin(azimuth) * lean, np.cos(azimuth) * lean, 1.0])
    light = np.empty((sheet.side, sheet.side, 3), np.float32)
    for rows, columns, plan in sheet.tiles(frame, SAMPLES):
        h, w = plan.shape[0] // SAMPLES, plan.shape[1] // SAMPLES
        flat = plan.reshape(-1, 2) - bias_m[:2]
        ground = np.column_stack([flat, ground_up(world, flat)])
        colours = scene.radiance(
            ground + ABOVE_M * to_satellite,
            np.broadcast_to(-to_satellite, ground.shape),
            pixel_m=sheet.pixel_m / SAMPLES,
        )
        light[rows, columns] = colours.reshape(h, SAMPLES, w, SAMPLES, 3).mean(axis=(1, 3))
    return _through_air(light, rng)


def _through_air(light: Array32, rng: np.random.Generator) -> Image:
    """Blur of the optics, haze, colours that come at a quarter of the resolution, and the maker's own tone curve."""
    sharp = cv2.GaussianBlur(light, (0, 0), 0.65)
    grey = sharp.mean(axis=2, keepdims=True)
    coarse = cv2.GaussianBlur(sharp, (0, 0), 1.8)
    tint = coarse / np.maximum(coarse.mean(axis=2, keepdims=True), 1e-3)
    # Makers undo a part of the blur.
    grey = 1.35 * grey - 0.35 * cv2.GaussianBlur(grey, (0, 0), 1.1)[..., None]
    # They also stretch what the low sun of winter leaves: few pixels are near white.
    haze, gain = rng.uniform(0.03, 0.09), rng.uniform(0.6, 0.85) / max(float(np.percentile(grey, 99)), 1e-3)
    balance = np.array([rng.uniform(0.88, 1.0), 1.0, rng.uniform(1.0, 1.12)])
    hazy = haze * np.array([0.8, 0.95, 1.2]) + gain * grey * tint * balance
    noise = rng.normal(scale=1.8, size=(*hazy.shape[:2], 1)) + rng.normal(scale=0.8, size=hazy.shape)
    tone = 255 * np.clip(hazy, 0, 1) ** (1 / rng.uniform(1.6, 2.0)) + noise
    return np.asarray(np.clip(tone + 0.5, 0, 255), dtype=np.uint8)


def _dsm(
    world: World, scene: Scene, frame: EnuFrame, sheet: MapSheet, bias_m: Array, rng: np.random.Generator
) -> Array32:
    """What stereo gives: edges smoothed, correlated noise, a few blunders, holes in shadows and on water."""
    shape = (sheet.side, sheet.side)
    up, label, dark = np.empty(shape, np.float32), np.empty(shape, np.uint8), np.empty(shape, bool)
    level = np.empty(shape)  # of the plane up = 0, above the ellipsoid
    for rows, columns, plan in sheet.tiles(frame, 1):
        flat = plan.reshape(-1, 2) - bias_m[:2]
        surface, seen = _from_above(world, scene, flat)
        sunward = np.broadcast_to(scene.sun, surface.shape)
        in_shadow = np.isfinite(scene.cast(surface + [0.0, 0.0, 0.2], sunward).distance)
        lla = frame.lla_from_enu(np.column_stack([plan.reshape(-1, 2), np.zeros(len(flat))]))
        for target, values in ((up, surface[:, 2]), (label, seen), (dark, in_shadow), (level, lla[:, 2])):
            target[rows, columns] = values.reshape(plan.shape[:2])
    smooth = cv2.GaussianBlur(cv2.medianBlur(up, 5), (0, 0), 0.9)
    noise = _correlated(rng, shape, 4.0 / sheet.pixel_m, 0.18) + _correlated(rng, shape, 1.0 / sheet.pixel_m, 0.15)
    water = label == Label.WATER
    noise *= np.where(water, np.float32(3.0), np.float32(1.0))
    patches = _correlated(rng, shape, 3.0 / sheet.pixel_m, 1.0)
    hole = (dark & (patches > 1.3)) | (water & (patches > 0.6)) | (patches > 3.3)
    heights = level + smooth + noise + _blunders(rng, shape, sheet.pixel_m) + bias_m[2]
    return np.where(hole, np.nan, heights).astype(np.float32)


def _from_above(world: World, scene: Scene, plan: Array) -> tuple[Array, NDArray[np.uint8]]:
    """The highest points (n, 3) at plan positions (n, 2), and their labels; the ground where nothing is modelled."""
    ground = ground_up(world, plan)
    above = np.column_stack([plan, ground + ABOVE_M])
    hits = scene.cast(above, np.broadcast_to([0.0, 0.0, -1.0], above.shape))
    up = np.where(np.isfinite(hits.distance), above[:, 2] - hits.distance, ground)
    return np.column_stack([plan, up]), hits.label


def _correlated(rng: np.random.Generator, shape: tuple[int, int], length_px: float, sigma: float) -> Array32:
    """Noise whose neighbours agree over about `length_px`."""
    noise = cv2.GaussianBlur(rng.standard_normal(shape, dtype=np.float32), (0, 0), max(length_px / 2, 0.1))
    return np.asarray(noise * (sigma / max(float(noise.std()), 1e-9)), dtype=np.float32)


def _blunders(rng: np.random.Generator, shape: tuple[int, int], pixel_m: float) -> Array32:
    """Blobs of wrong heights."""
    total = np.zeros(shape, np.float32)
    for radius_m in BLUNDER_RADII_M:
        radius = round(radius_m / pixel_m)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        share = BLUNDER_SHARE / len(BLUNDER_RADII_M) / float(disc.sum())
        for sign in (1, -1):
            seeds = np.where(rng.uniform(size=shape) < share / 2, rng.uniform(2.0, 8.0, shape), 0.0)
            total += sign * cv2.dilate(seeds.astype(np.float32), disc)
    return np.asarray(cv2.GaussianBlur(total, (0, 0), 0.7), dtype=np.float32)


def _write(path: Path, bands: NDArray[np.generic], sheet: MapSheet, **profile: object) -> None:
    layout = {"count": len(bands), "height": sheet.side, "width": sheet.side, "transform": sheet.transform}
    storage = {"tiled": True, "blockxsize": 256, "blockysize": 256, "compress": "deflate"}
    with rasterio.open(
        path, "w", driver="GTiff", dtype=bands.dtype, crs=sheet.crs, **layout, **storage, **profile
    ) as file:
        file.write(bands)
