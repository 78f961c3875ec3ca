# SPDX-License-Identifier: Apache-2.0
"""A geoid grid in place of PROJ's own, which are large."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio


def write_constant_geoid(path: Path, undulation_m: float) -> None:
    """A grid in PROJ's GeoTIFF form that covers 0 to 20 degrees east, 40 to 60 degrees north."""
    profile = {"driver": "GTiff", "width": 21, "height": 21, "count": 1, "dtype": "float32", "crs": "EPSG:4326"}
    transform = rasterio.Affine(1.0, 0.0, -0.5, 0.0, -1.0, 60.5)
    with rasterio.open(path, "w", transform=transform, **profile) as grid:
        grid.write(np.full((1, 21, 21), undulation_m, dtype=np.float32))
        grid.update_tags(AREA_OR_POINT="Point", TYPE="VERTICAL_OFFSET_GEOGRAPHIC_TO_VERTICAL")
        grid.set_band_description(1, "geoid_undulation")
        grid.units = ("metre",)
