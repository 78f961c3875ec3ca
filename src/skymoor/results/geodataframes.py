# SPDX-License-Identifier: Apache-2.0
"""Cameras and footprints of a run for geopandas, in WGS 84 or in another coordinate reference system."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from skymoor.engines.libraries import require
from skymoor.errors import InputError
from skymoor.geo.convert import map_crs, positions_in
from skymoor.geo.datum import horizontal_part

if TYPE_CHECKING:
    import geopandas

    from skymoor.results.read import Result

Layer = Literal["cameras", "footprints"]
GEOGRAPHIC = {"cameras": "EPSG:4979", "footprints": "EPSG:4326"}
"""The CRS of a layer where none is asked for."""


def geodataframe(result: Result, layer: Layer, crs: Any = None) -> geopandas.GeoDataFrame:
    """A layer of the run in a CRS that pyproj knows; see `Result.to_crs`."""
    if layer not in get_args(Layer):
        raise InputError(f"layer {layer!r} is not known; it is one of {', '.join(get_args(Layer))}")
    require("geopandas", "table")
    target = GEOGRAPHIC[layer] if crs is None else crs
    return _cameras(result, target) if layer == "cameras" else _footprints(result, target)


def _cameras(result: Result, crs: Any) -> geopandas.GeoDataFrame:
    import geopandas

    target, table = map_crs(crs), result.to_dataframe()
    lat, lon, height = table[["lat", "lon", "height"]].astype(float).to_numpy().T
    known = np.isfinite(lat)
    positions = np.full((len(table), 3), np.nan)
    found = positions_in(target, lat[known], lon[known], height[known])
    axes = len(target.axis_info)
    positions[known, :axes] = found
    points = geopandas.GeoSeries(geopandas.points_from_xy(*positions[:, :axes].T))
    return geopandas.GeoDataFrame(table, geometry=points.where(known), crs=target)


def _footprints(result: Result, crs: Any) -> geopandas.GeoDataFrame:
    import geopandas

    shapely = require("shapely", "table")
    # Here, since formats read results, and results are read without COLMAP and GDAL.
    from skymoor.results.formats._of_cameras import run_footprints
    from skymoor.results.formats._source import Source
    from skymoor.results.formats.geopackage import footprint_columns

    target, source = horizontal_part(map_crs(crs)), Source(result, result.folder)
    found = run_footprints(source)
    lon, lat = np.concatenate([np.zeros((0, 2)), *(one.outline for one in found)]).T
    xy = positions_in(target, lat, lon, np.full(len(lat), np.nan))
    ends = np.cumsum([len(one.outline) for one in found])[:-1]
    polygons = [shapely.Polygon(outline) for outline in np.split(xy, ends)] if found else []
    return geopandas.GeoDataFrame(footprint_columns(source.rows, found), geometry=polygons, crs=target)
