# SPDX-License-Identifier: Apache-2.0
"""Rasters and catalogues for a server: an orthophoto of 500 m, its DSM, tiles, and STAC about them."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import rasterio.shutil
from PIL import Image
from pyproj import Transformer
from rasterio import Affine
from rasterio.warp import transform_bounds

WEST, NORTH = 500_000.0, 5_200_000.0
CRS = "EPSG:32632"
BBox = tuple[float, float, float, float]


def box(left_m: float = 200.0, top_m: float = 200.0, side_m: float = 100.0) -> BBox:
    """A square in the orthophoto, as longitudes and latitudes."""
    t = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True)
    west, south = t.transform(WEST + left_m, NORTH - top_m - side_m)
    east, north = t.transform(WEST + left_m + side_m, NORTH - top_m)
    return west, south, east, north


def write_ortho(path: Path, *, left_m: float = 0.0, side: int = 1000, seed: int = 1, **profile: Any) -> Path:
    """A Cloud-Optimised GeoTIFF of noise, 0.5 m."""
    rng = np.random.default_rng(seed)
    values = rng.integers(1, 255, (3, side, side)).astype(np.uint8)
    plain = path.with_name(f"plain_{path.name}")
    transform = Affine(0.5, 0.0, WEST + left_m, 0.0, -0.5, NORTH)
    size = {"width": side, "height": side, "count": 3, "dtype": "uint8"}
    with rasterio.open(plain, "w", driver="GTiff", crs=CRS, transform=transform, **size, **profile) as file:
        file.write(values)
    rasterio.shutil.copy(plain, path, driver="COG", compress="DEFLATE", blocksize=128, overview_resampling="AVERAGE")
    plain.unlink()
    return path


def write_dsm(path: Path, *, crs: str = "EPSG:32632+3855", left_m: float = 0.0, seed: int = 2) -> Path:
    """Heights, 1 m."""
    heights = np.random.default_rng(seed).normal(400.0, 3.0, (1, 500, 500)).astype(np.float32)
    transform = Affine(1.0, 0.0, WEST + left_m, 0.0, -1.0, NORTH)
    size = {"width": 500, "height": 500, "count": 1, "dtype": "float32"}
    with rasterio.open(
        path, "w", driver="GTiff", crs=crs, transform=transform, tiled=True, nodata=-9999.0, **size
    ) as file:
        file.write(heights)
    return path


def item(name: str, file: Path, date: str, **changes: Any) -> dict[str, Any]:
    """A STAC item about a raster beside it."""
    with rasterio.open(file) as source:
        west, south, east, north = transform_bounds(source.crs, "EPSG:4326", *source.bounds)
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    assets = {
        "image": {"href": f"./{file.name}", "type": "image/tiff; application=geotiff", "roles": ["data"]},
        "thumbnail": {"href": "./small.png", "type": "image/png", "roles": ["thumbnail"]},
    }
    made = {
        "type": "Feature",
        "stac_version": "1.0.0",
        "id": name,
        "bbox": [west, south, east, north],
        "geometry": {"type": "Polygon", "coordinates": [ring]},
        "properties": {
            "datetime": date,
            "license": "CC-BY-4.0",
            "providers": [{"name": "Survey of Nowhere", "roles": ["producer"]}, {"name": "a host", "roles": ["host"]}],
        },
        "assets": assets,
        "links": [],
    }
    return {**made, **changes}


def collection(name: str, links: list[dict[str, str]]) -> dict[str, Any]:
    """A STAC collection."""
    return {
        "type": "Collection",
        "stac_version": "1.0.0",
        "id": name,
        "description": "for tests",
        "license": "CC0-1.0",
        "extent": {"spatial": {"bbox": [[-180, -90, 180, 90]]}, "temporal": {"interval": [[None, None]]}},
        "links": links,
    }


def write_static_catalogue(folder: Path, items: list[dict[str, Any]]) -> None:
    """collection.json and the items beside it, with relative links."""
    for one in items:
        (folder / f"{one['id']}.json").write_text(json.dumps(one))
    links = [{"rel": "item", "href": f"./{one['id']}.json", "type": "application/geo+json"} for one in items]
    (folder / "collection.json").write_text(json.dumps(collection("survey", links)))


def tile(path: str) -> bytes | None:
    """A tile /t/z/x/y.png down to level 18, whose red and green are its column and row."""
    found = re.match(r"t/(\d+)/(\d+)/(\d+)\.png", path)
    if found is None or int(found[1]) > 18:
        return None
    rgb = np.zeros((256, 256, 3), np.uint8)
    rgb[..., 0], rgb[..., 1] = int(found[2]) % 256, int(found[3]) % 256
    rgb[..., 2] = np.arange(256)[:, None]
    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, "png")
    return buffer.getvalue()


def wmts(address: str) -> str:
    """The capabilities of a WMTS in web Mercator, with levels 17 and 18 of the tiles above."""
    half = 20037508.342789244
    levels = "".join(
        f"<TileMatrix><ows:Identifier>{z}</ows:Identifier>"
        f"<ScaleDenominator>{2 * half / (256 * 2**z) / 0.00028}</ScaleDenominator>"
        f"<TopLeftCorner>-{half} {half}</TopLeftCorner><TileWidth>256</TileWidth><TileHeight>256</TileHeight>"
        f"<MatrixWidth>{2**z}</MatrixWidth><MatrixHeight>{2**z}</MatrixHeight></TileMatrix>"
        for z in (17, 18)
    )
    return (
        '<?xml version="1.0"?><Capabilities xmlns="http://www.opengis.net/wmts/1.0" '
        'xmlns:ows="http://www.opengis.net/ows/1.1" xmlns:xlink="http://www.w3.org/1999/xlink" version="1.0.0">'
        "<Contents><Layer><ows:Title>photo</ows:Title><ows:Identifier>photo</ows:Identifier>"
        '<Style isDefault="true"><ows:Identifier>default</ows:Identifier></Style><Format>image/png</Format>'
        "<TileMatrixSetLink><TileMatrixSet>web</TileMatrixSet></TileMatrixSetLink>"
        f'<ResourceURL format="image/png" resourceType="tile" '
        f'template="{address}/t/{{TileMatrix}}/{{TileCol}}/{{TileRow}}.png"/></Layer>'
        "<TileMatrixSet><ows:Identifier>web</ows:Identifier>"
        f"<ows:SupportedCRS>urn:ogc:def:crs:EPSG::3857</ows:SupportedCRS>{levels}</TileMatrixSet></Contents>"
        "</Capabilities>"
    )
