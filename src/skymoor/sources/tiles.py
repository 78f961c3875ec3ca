# SPDX-License-Identifier: Apache-2.0
"""Tile services with {x}, {y} and {z} in their address, as rasters for GDAL."""

from __future__ import annotations

import re
from xml.sax.saxutils import escape

import numpy as np

from skymoor.sources.remote import TIMEOUT_S

HALF_WORLD_M = 20037508.342789244
TILE_PX = 256
FINEST_ZOOM = 23
# Without --pixel: that of what most services have everywhere.
PIXEL_M = 0.6


def zoom_of(pixel_m: float, lat_deg: float) -> int:
    """The coarsest level whose pixel is not larger than `pixel_m` on the ground."""
    world_m = 2 * HALF_WORLD_M * float(np.cos(np.radians(lat_deg)))
    return int(np.clip(np.ceil(np.log2(world_m / (TILE_PX * pixel_m)) - 1e-9), 0, FINEST_ZOOM))


def tile_service(template: str, zoom: int) -> str:
    """GDAL's description of one level of a service, in web Mercator: RGB and alpha, which is 0 where it has no tile.

    {-y} counts from the south. Tiles are kept in `tile_folder`: GDAL asks for each of them once for every band.
    """
    origin = "bottom" if "{-y}" in template else "top"
    address = re.sub(r"\{-?([xyz])\}", r"${\1}", template)
    return (
        f'<GDAL_WMS><Service name="TMS"><ServerUrl>{escape(address)}</ServerUrl></Service>'
        f"<DataWindow><UpperLeftX>-{HALF_WORLD_M}</UpperLeftX><UpperLeftY>{HALF_WORLD_M}</UpperLeftY>"
        f"<LowerRightX>{HALF_WORLD_M}</LowerRightX><LowerRightY>-{HALF_WORLD_M}</LowerRightY>"
        f"<TileLevel>{zoom}</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY>"
        f"<YOrigin>{origin}</YOrigin></DataWindow><Projection>EPSG:3857</Projection>"
        f"<BlockSizeX>{TILE_PX}</BlockSizeX><BlockSizeY>{TILE_PX}</BlockSizeY><BandsCount>4</BandsCount>"
        "<ZeroBlockHttpCodes>204,404</ZeroBlockHttpCodes><ZeroBlockOnServerException>false</ZeroBlockOnServerException>"
        f"<Cache/><MaxConnections>4</MaxConnections><Timeout>{TIMEOUT_S}</Timeout><UserAgent>skymoor</UserAgent></GDAL_WMS>"
    )
