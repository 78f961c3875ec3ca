# SPDX-License-Identifier: Apache-2.0
"""Where and in which systems a run was made: date, coordinate systems, the area that was searched, hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from math import hypot
from pathlib import Path
from typing import Any

from pyproj import CRS
from pyproj.exceptions import CRSError

from skymoor.errors import InputError
from skymoor.geo.datum import ELLIPSOID, horizontal_part, vertical_datum_of
from skymoor.pipeline.job import ComponentResult
from skymoor.pipeline.site import Site
from skymoor.reference.raster import MapRaster
from skymoor.store import StageRecord
from skymoor.types import Reference

HYPOTHESES = 3  # of each component in the summary
ELLIPSOIDAL = {"name": "height above the WGS 84 ellipsoid", "epsg": 4979}


def run_figures(site: Site, reference: Reference, records: Sequence[StageRecord]) -> dict[str, Any]:
    """For summary.json: when the run finished (UTC), how long its stages took, its systems, and what was searched.

    `coordinate_systems` are those of the products (`crs`, with heights above the ellipsoid), and of the reference's
    heights; each has a name, and an EPSG code where it has one. `search` is the area in ENU metres, and how much of it
    the orthophoto covers.
    """
    grid = reference.grid
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "seconds": sum(record.seconds for record in records),
        "coordinate_systems": {
            "crs": _named(reference.crs),
            "heights": ELLIPSOIDAL,
            "reference_heights": reference_heights(site) if reference.has_heights else None,
        },
        "search": {
            "bounds_m": grid.bounds,
            "area_m2": float(reference.mask.sum()) * grid.pixel_m**2,
            "limited": site.bounds.area is not None,
        },
    }


def reference_heights(site: Site) -> dict[str, Any] | None:
    """Name and EPSG code of the vertical system of the reference's heights; None where nothing says it."""
    files = site.reference
    datum = files.vertical_datum
    if datum is None and isinstance(files.dsm, Path):
        try:
            datum = MapRaster.of(files.dsm).vertical_datum
        except InputError:  # gone since the run read it
            return None
    if datum is None:
        return None
    if datum.strip().lower() == ELLIPSOID:
        return ELLIPSOIDAL
    try:
        return _named(vertical_datum_of(datum) or datum)
    except CRSError:
        return None


def hypotheses_of(item: ComponentResult, reference: Reference, count: int = HYPOTHESES) -> list[dict[str, float]]:
    """The best hypotheses of a component, accepted or not, with their distance from the first in metres."""
    rows = []
    for one in item.hypotheses[:count]:
        first = item.hypotheses[0]
        lat, lon, _ = reference.frame.lla_from_enu([[one.east, one.north, 0.0]])[0].tolist()
        distance = hypot(one.east - first.east, one.north - first.north)
        rows.append({"lat": lat, "lon": lon, **asdict(one), "distance_m": distance})
    return rows


def _named(text: str) -> dict[str, Any]:
    if text.strip().lower() == ELLIPSOID:
        return ELLIPSOIDAL
    crs = CRS.from_user_input(text)
    part = crs if crs.is_vertical and not crs.is_compound else horizontal_part(text)
    return {"name": part.name, "epsg": part.to_epsg()}
