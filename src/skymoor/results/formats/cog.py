# SPDX-License-Identifier: Apache-2.0
"""Rasters as Cloud-Optimised GeoTIFFs."""

from __future__ import annotations

from pathlib import Path

import rasterio.shutil
from rasterio._err import CPLE_BaseError  # it comes out of GDAL as it is
from rasterio.errors import RasterioError

from skymoor.errors import InputError


def write_cog(source: Path, target: Path) -> None:
    """Copy a GeoTIFF, values, tags and CRS as they are, into the order that is read in parts over a network.

    Raises `InputError` for one that is damaged.
    """
    options = {"compress": "DEFLATE", "predictor": "YES", "overview_resampling": "AVERAGE", "blocksize": 256}
    try:
        rasterio.shutil.copy(source, target, driver="COG", **options)
    except (RasterioError, CPLE_BaseError) as error:
        raise InputError(f"{source}: cannot be copied ({error}); run skymoor run again") from error
