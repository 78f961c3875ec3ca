# SPDX-License-Identifier: Apache-2.0
"""A run as a STAC item: where it is, how accurate, and its products as assets."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pystac
import rasterio
from pyproj import CRS, Transformer

from skymoor.results.read import Result
from skymoor.types import Array

PROJECTION = "https://stac-extensions.github.io/projection/v2.0.0/schema.json"
FILE = "https://stac-extensions.github.io/file/v2.1.0/schema.json"
GEOTIFF = "image/tiff; application=geotiff"
ASSETS = {
    "ortho": ("ortho.tif", GEOTIFF, "Orthophoto", ["data", "visual"]),
    "dsm": ("dsm.tif", GEOTIFF, "Surface model, metres above the WGS 84 ellipsoid", ["data"]),
    "confidence": ("confidence.tif", GEOTIFF, "Confidence of the surface model, percent", ["metadata"]),
    "pointcloud": ("pointcloud.laz", "application/vnd.laszip", "Point cloud", ["data"]),
    "cameras": ("cameras.geojson", "application/geo+json", "Camera positions", ["data"]),
    "report": ("report.html", "text/html", "Report", ["overview"]),
    "summary": ("summary.json", "application/json", "Summary", ["metadata"]),
}
COARSEST = 500  # pixels along the outline of the surface: metres are enough


def stac_item(result: Result, finished: datetime, hrefs: Mapping[str, str]) -> dict[str, Any]:
    """A STAC 1.1 item with the extensions projection and file; `hrefs` are those of the product files that there are.

    Its time is when the run was finished, since photos may not state theirs. Geometry is the convex hull of the surface
    model, or of the cameras. `skymoor:components` states what was registered, with CE90 and LE90 in metres.
    """
    outline = _outline(result)
    ring = np.vstack([outline, outline[:1]]).round(8).tolist()
    name = str(result.summary.get("site") or result.folder.resolve().name)
    item = pystac.Item(
        id=f"{re.sub('[^a-z0-9]+', '-', name.lower()).strip('-')}-{finished:%Y%m%dT%H%M%SZ}",
        geometry={"type": "Polygon", "coordinates": [ring]},
        bbox=[*outline.min(axis=0).tolist(), *outline.max(axis=0).tolist()],
        datetime=finished,
        properties={"title": name, "description": "The time is when skymoor finished.", **_facts(result)},
        stac_extensions=[PROJECTION, FILE],
    )
    for key, (file, media, title, roles) in ASSETS.items():
        if file in hrefs:
            more = _file(result.folder / file) | (_projection(result.folder / file) if media == GEOTIFF else {})
            item.add_asset(key, pystac.Asset(hrefs[file], title, None, media, roles, more))
    found: dict[str, Any] = item.to_dict(include_self_link=False)
    return found


def _facts(result: Result) -> dict[str, Any]:
    components = [
        {
            "name": one.name,
            "status": "REGISTERED" if one.registered else "NOT_REGISTERED",
            "heights": one.heights,
            "ce90_m": one.ce90_m,
            "le90_m": one.le90_m,
            "cameras": sum((row.set, row.component) == (one.image_set, one.index) for row in result.registered_cameras),
        }
        for one in result.components
    ]
    reference = {key: one for key in ("licence", "credit", "date") if (one := result.summary["reference"].get(key))}
    return {
        "skymoor:version": result.summary.get("skymoor"),
        "skymoor:components": components,
        **({"skymoor:reference": reference} if reference else {}),
    }


def _file(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"file:size": path.stat().st_size, "file:checksum": f"1220{digest}"}  # a multihash: sha256, 32 bytes


def _projection(path: Path) -> dict[str, Any]:
    with rasterio.open(path) as raster:
        authority = CRS.from_wkt(raster.crs.to_wkt()).to_authority()
        code: dict[str, Any] = {"proj:code": ":".join(authority) if authority else None}
        if authority is None:
            code["proj:wkt2"] = CRS.from_wkt(raster.crs.to_wkt()).to_wkt()
        return code | {
            "proj:shape": [raster.height, raster.width],
            "proj:transform": list(raster.transform)[:6],
            "proj:bbox": list(raster.bounds),
        }


def _outline(result: Result) -> Array:
    """Longitude and latitude (n, 2) of a convex outline, counter-clockwise."""
    path = result.folder / "dsm.tif"
    if path.is_file():
        with rasterio.open(path) as dsm:
            step = max(1, max(dsm.shape) // COARSEST)
            rows, columns = np.nonzero(dsm.read_masks(1)[::step, ::step])
            t, u, v = dsm.transform, columns * step + 0.5, rows * step + 0.5
            x, y = t.a * u + t.b * v + t.c, t.d * u + t.e * v + t.f
            to_lon_lat = Transformer.from_crs(CRS.from_wkt(dsm.crs.to_wkt()), "EPSG:4326", always_xy=True)
            plan = np.column_stack(to_lon_lat.transform(x, y))
    else:
        plan = np.array([[row.lon, row.lat] for row in result.registered_cameras], np.float64)
    middle = plan.mean(axis=0)
    # OpenCV has single precision: metres from the middle, roughly, keep it.
    hull = cv2.convexHull(((plan - middle) * 1e5).astype(np.float32)[:, None], returnPoints=False).ravel()
    ring: Array = plan[hull]
    x, y = (ring - middle).T
    return ring if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0 else ring[::-1]
