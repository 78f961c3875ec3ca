# SPDX-License-Identifier: Apache-2.0
"""Rasters as Cloud-Optimised GeoTIFFs."""

from __future__ import annotations

from pathlib import Path

import rasterio.shutil


def write_cog(source: Path, target: Path) -> None:
    """Copy a GeoTIFF, values, tags and CRS as they are, into the order that is read in parts over a network."""
    rasterio.shutil.copy(
        source, target, driver="COG", compress="DEFLATE", predictor="YES", overview_resampling="AVERAGE", blocksize=256
    )
