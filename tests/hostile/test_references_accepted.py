# SPDX-License-Identifier: Apache-2.0
"""Rasters that are odd but good: the same colours and heights at the same places as from the plain ones."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from PIL import Image

import skymoor.reference.heights
import skymoor.reference.raster
from support.map_scene import (
    DSM_M,
    ORTHO_M,
    assert_is_the_scene,
    layout,
    moved,
    positions,
    read,
    rewrite,
    scene_colours,
    scene_height,
    write_dsm,
    write_ortho,
)

UTM = "EPSG:32632"
Files = tuple[Path, Path]


def laid(ortho: str, dsm: str) -> Callable[[Path], Files]:
    return lambda folder: (write_ortho(folder, UTM, ortho), write_dsm(folder, UTM, dsm))


def stored(**profile: Any) -> Callable[[Path], Files]:
    """Both rasters in another way of storing them."""
    return lambda folder: (rewrite(write_ortho(folder), **profile), rewrite(write_dsm(folder), **profile))


def of_points(kind: str) -> Callable[[Path], Files]:
    """PixelIsPoint: the tie point names the centre of the first pixel and not its corner."""

    def make(folder: Path) -> Files:
        files = write_ortho(folder, UTM, kind), write_dsm(folder, UTM, kind)
        corners = [rasterio.open(file).transform.c for file in files]
        for file, corner, pixel in zip(files, corners, (ORTHO_M, DSM_M), strict=True):
            with rasterio.open(file, "r+") as raster:
                raster.update_tags(AREA_OR_POINT="Point")
                raster.transform = raster.transform  # so that GDAL writes it anew
            with Image.open(file) as tiff:
                tags = dict(tiff.tag_v2)  # type: ignore[attr-defined]
            # ModelTiepointTag, or ModelTransformationTag where the first row is in the south.
            assert tags.get(33922, tags.get(34264))[3] == pytest.approx(corner + pixel / 2, abs=1e-6)
        return files

    return make


def changed_dsm(change: Callable[[NDArray[Any]], NDArray[Any]], **profile: Any) -> Callable[[Path], Files]:
    return lambda folder: (write_ortho(folder), rewrite(write_dsm(folder), change, **profile))


def holes(value: float, **profile: Any) -> Callable[[Path], Files]:
    def change(bands: NDArray[np.float32]) -> NDArray[np.float32]:
        bands[:, 20:40, 30:50] = value
        bands[:, 3, 7] = value
        return bands

    return changed_dsm(change, **profile)


def centimetres(folder: Path) -> Files:
    files = changed_dsm(lambda bands: np.rint((bands - 400) * 100).astype(np.uint16))(folder)
    with rasterio.open(files[1], "r+") as raster:
        raster.scales, raster.offsets = (0.01,), (400.0,)
    return files


def virtual(folder: Path) -> Files:
    """Through a VRT, as gdalbuildvrt makes them."""
    files = write_ortho(folder), write_dsm(folder)
    with rasterio.open(files[1]) as raster:
        a, b, c, d, e, f = tuple(raster.transform)[:6]
        (folder / "dsm.vrt").write_text(
            f'<VRTDataset rasterXSize="{raster.width}" rasterYSize="{raster.height}"><SRS>{UTM}</SRS>'
            f"<GeoTransform>{c!r}, {a!r}, {b!r}, {f!r}, {d!r}, {e!r}</GeoTransform>"
            '<VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
            '<SourceFilename relativeToVRT="1">dsm.tif</SourceFilename><SourceBand>1</SourceBand>'
            "</SimpleSource></VRTRasterBand></VRTDataset>"
        )
    return files[0], folder / "dsm.vrt"


def odd_names(folder: Path) -> Files:
    other = folder / "наш ортофото, 1 [neu]%20"
    other.mkdir()
    files = write_ortho(folder), write_dsm(folder)
    return shutil.move(files[0], other / "örtho (1).TIF"), shutil.move(files[1], other / "高さ.tiff")


def far_too_large(folder: Path) -> Files:
    """The scene in the middle of ten gigapixels, of which nearly all lie outside of the DSM and are not stored."""
    transform, (rows, columns) = layout(UTM, ORTHO_M)
    colours = np.rint(scene_colours(*positions(transform, (rows, columns), UTM))).astype(np.uint8)
    side = 100_000
    window = rasterio.windows.Window(side // 2, side // 2, columns, rows)
    profile = {"driver": "GTiff", "count": 3, "height": side, "width": side, "dtype": np.uint8, "crs": UTM}
    place = moved(transform, -side // 2, -side // 2)
    path = folder / "large.tif"
    with rasterio.open(path, "w", **profile, transform=place, tiled=True, SPARSE_OK=True, BIGTIFF="YES") as raster:
        raster.write(colours, window=window)
    assert path.stat().st_size < 20e6
    return path, write_dsm(folder)


CASES: list[tuple[str, Callable[[Path], Files]]] = [
    ("south-up", laid("south-up", "south-up")),
    ("south-up on north-up", laid("south-up", "north-up")),
    ("east to west", laid("east to west", "east to west")),
    ("rotated", laid("rotated", "north-up")),
    ("far rotated", laid("far rotated", "rotated")),
    ("pixel is point", of_points("north-up")),
    ("pixel is point, south-up", of_points("south-up")),
    ("nan in the dsm", holes(np.nan)),
    ("nan declared as nodata", holes(np.nan, nodata=np.nan)),
    ("inf in the dsm", holes(np.inf)),
    ("minus inf in the dsm", holes(-np.inf)),
    ("heights of 64 bits", changed_dsm(lambda bands: bands.astype(np.float64))),
    ("heights in centimetres with scale and offset", centimetres),
    ("tiles", stored(tiled=True, blockxsize=16, blockysize=16, compress="deflate")),
    ("big endian, bigtiff, predictor", stored(ENDIANNESS="BIG", BIGTIFF="YES", compress="lzw", predictor=2)),
    ("planes apart", stored(interleave="band", compress="zstd")),
    ("vrt", virtual),
    ("names in other scripts", odd_names),
    ("ten gigapixels", far_too_large),
]


@pytest.mark.parametrize("make", [case[1] for case in CASES], ids=[case[0] for case in CASES])
def test_the_same_heights_at_the_same_places(make: Callable[[Path], Files], tmp_path: Path) -> None:
    assert_is_the_scene(read(*make(tmp_path)))


def test_colours_that_are_no_numbers_are_masked(tmp_path: Path) -> None:
    def spoil(bands: NDArray[np.uint8]) -> NDArray[np.float32]:
        numbers = bands.astype(np.float32)
        numbers[1, 50:90, 60:100], numbers[2, 120:130, 60:100] = np.nan, np.inf
        return numbers

    reference = read(rewrite(write_ortho(tmp_path), spoil), write_dsm(tmp_path))
    area = (~reference.mask & np.isfinite(reference.height)).sum() * reference.grid.pixel_m**2
    assert area == pytest.approx(50 * 40 * ORTHO_M**2, rel=0.05)


def test_a_palette_of_16_bits(tmp_path: Path) -> None:
    plain = read(write_ortho(tmp_path), write_dsm(tmp_path))
    path = rewrite(tmp_path / "ortho.tif", lambda bands: bands[:1].astype(np.uint16) + 1000)
    with rasterio.open(path, "r+") as raster:
        raster.write_colormap(1, {1000 + k: (k, 255 - k, 7, 255) for k in range(256)})
    found = read(path, tmp_path / "dsm.tif")
    assert np.abs(found.rgb[found.mask].astype(int)[:, 0] - plain.rgb[plain.mask][:, 0]).max() < 3
    assert (found.rgb[found.mask][:, 2] == 7).all()


def test_a_source_hundreds_of_times_finer_is_thinned_in_bounded_pieces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # 5 cm under a grid of 4 m.
    ortho, dsm = write_ortho(tmp_path), write_dsm(tmp_path, pixel_m=0.05)
    reads: list[int] = []

    def counted(source: Any, window: Any, thin: Any = (1, 1)) -> Any:
        found = skymoor.reference.raster.read_heights(source, window, thin)
        reads.append(found.size)
        return found

    monkeypatch.setattr(skymoor.reference.heights, "read_heights", counted)
    thinned = read(ortho, dsm, pixel_m=4.0)
    assert max(reads) < 1_300_000  # of the 4.8 million that the file holds
    monkeypatch.setattr("skymoor.reference.resample.SAMPLES", 10**6)
    whole = read(ortho, dsm, pixel_m=4.0)
    both = np.isfinite(thinned.height) & np.isfinite(whole.height)
    assert both.sum() >= (both.shape[0] - 2) * (both.shape[1] - 2)  # at the rim a block more or less is complete
    np.testing.assert_allclose(thinned.height[both], whole.height[both], atol=0.02)
    assert np.abs(thinned.rgb.astype(int) - whole.rgb).max() <= 1


def test_scene_is_not_flat() -> None:
    """What the cases above would not see in a flat scene."""
    transform, shape = layout(UTM, DSM_M)
    assert np.ptp(scene_height(*positions(transform, shape, UTM))) > 15
