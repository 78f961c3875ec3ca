# SPDX-License-Identifier: Apache-2.0
"""Small valid sites, tables, rasters, photos and videos."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from PIL import Image
from rasterio import Affine
from rasterio.errors import NotGeoreferencedWarning

Array = NDArray[np.float64]
CRS, EAST_M, NORTH_M = "EPSG:32617", 500_000.0, 3_000_000.0
SITE = """name = "site"
[reference]
ortho = "ortho.tif"
dsm = "dsm.tif"
vertical_datum = "ellipsoid"
ce90 = 2.5
le90 = 3.8
licence = "CC0"
[airborne]
images = "air"
[[ground]]
images = ["walk"]
[prior]
near = [27.12, -81.0, 500.0]
heading = "0.png=240"
height = 60.0
[control]
files = ["points.csv"]
vertical_datum = "ellipsoid"
ce90 = 0.1
le90 = 0.2
[options]
match.min_height_m = 20
"register.min_score" = 3
"""
POINTS = """point,image,px,py,lat,lon,height,sigma_h,sigma_v
a,air/0.png,10.5,20.5,27.1201,-81.0001,10.5,0.02,0.03
a,air/1.png,11.5,21.5,,,,,
"b, c",air/0.png,30,40,27.1202,-81.0002,11.5,0.02,0.03
"""
BARS = "point_a,point_b,length_m,sigma_m\na,b,1.5,0.01\nb,a,2.5,0.02\n"
ODM_LIST = "WGS84 UTM 17N\n500010 2999990 10.5 12 34 0.png gcp1\n500010 2999990 10.5 13 35 1.png gcp1\n"
ODM_GEO = "EPSG:4326\n0.png -81.0001 27.1201 50.5 10 20 30 2.0 3.0\n1.png -81.0002 27.1202 50.5\n"
POSITIONS = "image,x,y,z,ce90,le90\n0.png,500010,2999990,50.5,2,3\n1.png,500020,2999980,50.5,2,3\n"
TRUTH = "image,lat,lon,height\nair/0.png,27.1201,-81.0001,60.5\nair/1.png,27.1202,-81.0002,60.5\n"


def picture(width: int = 96, height: int = 72, seed: int = 0) -> NDArray[np.uint8]:
    """Noise with some texture (h, w, 3)."""
    small = np.random.default_rng(seed).integers(0, 255, (height // 4, width // 4, 3), np.uint8)
    return np.asarray(cv2.resize(small, (width, height)), np.uint8)


def raster(path: Path, bands: NDArray[Any], *, placed: bool = True, **profile: Any) -> None:
    """Bands (n, h, w) at half a metre."""
    count, height, width = bands.shape
    place = {"crs": CRS, "transform": Affine(0.5, 0, EAST_M, 0, -0.5, NORTH_M)} if placed else {}
    sizes = {"driver": "GTiff", "count": count, "height": height, "width": width, "dtype": bands.dtype}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **{**sizes, **place, **profile}) as file:
            file.write(bands)


def write_photos(folder: Path, count: int = 3) -> None:
    folder.mkdir(parents=True)
    for k in range(count):
        Image.fromarray(picture(seed=k)).save(folder / f"{k}.png")


def reference(folder: Path) -> None:
    tiles = {"tiled": True, "blockxsize": 32, "blockysize": 32, "compress": "deflate"}
    raster(folder / "ortho.tif", picture(80, 80).transpose(2, 0, 1), **tiles)
    raster(folder / "dsm.tif", np.random.default_rng(0).normal(10, 1, (1, 80, 80)).astype(np.float32), nodata=-9999.0)


def site(folder: Path) -> None:
    reference(folder)
    write_photos(folder / "air")
    write_photos(folder / "walk")
    (folder / "points.csv").write_text(POINTS)
    (folder / "site.toml").write_text(SITE)


def vrt(folder: Path) -> None:
    reference(folder)
    band = '<VRTRasterBand dataType="{}" band="{}"><SimpleSource><SourceFilename relativeToVRT="1">{}</SourceFilename>'
    band += "<SourceBand>{}</SourceBand></SimpleSource></VRTRasterBand>"
    head = '<VRTDataset rasterXSize="80" rasterYSize="80"><SRS>EPSG:32617</SRS>'
    head += f"<GeoTransform>{EAST_M}, 0.5, 0, {NORTH_M}, 0, -0.5</GeoTransform>"
    colours = "".join(band.format("Byte", k, "ortho.tif", k) for k in (1, 2, 3))
    (folder / "ortho.vrt").write_text(head + colours + "</VRTDataset>")
    (folder / "dsm.vrt").write_text(head + band.format("Float32", 1, "dsm.tif", 1) + "</VRTDataset>")


def world_file(folder: Path) -> None:
    reference(folder)
    Image.fromarray(picture(80, 80)).save(folder / "ortho.png")
    (folder / "ortho.pgw").write_text(f"0.5\n0\n0\n-0.5\n{EAST_M + 0.25}\n{NORTH_M - 0.25}\n")
    srs = rasterio.crs.CRS.from_string(CRS).to_wkt()
    (folder / "ortho.png.aux.xml").write_text(f"<PAMDataset><SRS>{srs.replace('<', '&lt;')}</SRS></PAMDataset>")


def photos(folder: Path) -> None:
    import pillow_heif

    pillow_heif.register_heif_opener()
    folder = folder / "air"
    folder.mkdir(parents=True)
    exif = Image.Exif()
    exif[271], exif[274] = "Acme", 6
    first = Image.fromarray(picture())
    for name in ("a.jpg", "b.png", "c.tif", "d.heic", "e.webp", "f.bmp", "g.avif"):
        first.save(folder / name, **({"exif": exif} if name[0] in "ad" else {}))
    first.save(folder / "h.jpg", progressive=True)
    first.save(folder / "i.mpo", "MPO", save_all=True, append_images=[Image.fromarray(picture(seed=1))])
    first.save(folder / "j.tif", compression="tiff_lzw")
    first.convert("P").save(folder / "k.png")
    Image.fromarray(picture()[..., 0].astype(np.uint16) << 8).save(folder / "l.tif")


def video(folder: Path) -> None:
    import av

    wide = picture(480, 72)
    for name, codec in (("clip.mp4", "mpeg4"), ("clip2.avi", "mpeg4")):
        with av.open(str(folder / name), "w") as container:
            stream = container.add_stream(codec, rate=6)
            stream.width, stream.height, stream.pix_fmt = 96, 72, "yuv420p"
            for k in range(12):
                frame = np.ascontiguousarray(wide[:, 20 * k : 20 * k + 96])
                container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            container.mux(stream.encode())


def tables(folder: Path) -> None:
    (folder / "points.csv").write_text(POINTS)
    (folder / "bars.csv").write_text(BARS.replace("b", '"b, c"').replace('point_"b, c"', "point_b"))
    (folder / "gcp_list.txt").write_text(ODM_LIST)
    (folder / "geo.txt").write_text(ODM_GEO)
    (folder / "positions.csv").write_text(POSITIONS.replace("0.png", "2.png").replace("1.png", "3.png"))
    (folder / "truth.csv").write_text(TRUTH)


def index(folder: Path) -> None:
    from skymoor.pipeline.feature_index import write_index

    reference(folder)
    write_index(folder / "ortho.tif")
