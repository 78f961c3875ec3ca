# SPDX-License-Identifier: Apache-2.0
"""What to say where the accuracy of a reference is not stated; docs/references.md has the sources."""

from __future__ import annotations

from collections.abc import Sequence

USUAL = (
    "usual values, in metres, 90 percent (check the page of your product; docs/references.md has more):",
    "  source                                         ce90    le90    vertical_datum",
    "  Copernicus DEM GLO-30                          6       4       EPSG:3855",
    "  SRTM                                           20      16      EPSG:5773",
    "  ALOS AW3D30 (5 m RMS in plan and height)       10.7    8.2     EPSG:5773",
    "  NAIP orthophoto                                5.3     -       -",
    "  USGS 3DEP elevation                            by project      EPSG:5703",
    "  national orthophotos and LiDAR surface models  0.2-2   0.2-1   the country's, such as EPSG:5703",
    "  Maxar, Airbus and other orders                 with the product",
    '  Google, Bing, Esri basemaps; OpenAerialMap     none stated: accuracy = "unknown"',
)


def not_stated(missing: Sequence[str], where: str) -> str:
    """One line that names what is missing, and the remedy on the command line or in a site.toml."""
    flags = {"ce90": "--ce90 M", "le90": "--le90 M", "vertical_datum": "--vertical-datum EPSG:CODE"}
    keys = {"ce90": "ce90 = M", "le90": "le90 = M", "vertical_datum": 'vertical_datum = "EPSG:CODE"'}
    if where == "command line":
        remedy = f"give {' '.join(flags[one] for one in missing)}, or --accuracy unknown where nobody knows"
    else:
        lines = " and ".join(keys[one] for one in missing)
        remedy = f'write {lines} in [reference], or accuracy = "unknown" where nobody knows'
    what = " and ".join(missing)
    return f"{where}: the accuracy of the reference is not stated: {what} missing; {remedy}"
