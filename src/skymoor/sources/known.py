# SPDX-License-Identifier: Apache-2.0
"""What is known of a source: datum, accuracy, licence, credit and date; and the sources that skymoor knows by name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Literal

Kind = Literal["ortho", "dsm"]
"""What a source is used as."""


@dataclass(frozen=True)
class Facts:
    """What a source, or this table, says of a raster; None where nothing is known.

    `vertical_datum` is as in site.toml, `ce90` and `le90` are absolute, metres, 90 percent; `licence`, `credit` and
    `date` are text.
    """

    vertical_datum: str | None = None
    ce90: float | None = None
    le90: float | None = None
    licence: str | None = None
    credit: str | None = None
    date: str | None = None

    def or_else(self, other: Facts) -> Facts:
        """The same, with the facts of `other` where nothing is known."""
        missing = {item.name: getattr(other, item.name) for item in fields(self) if getattr(self, item.name) is None}
        return replace(self, **missing)


@dataclass(frozen=True)
class Known:
    """A source by words of which one is in its address or is its collection, in lower case."""

    words: tuple[str, ...]
    facts: Facts


_COPERNICUS = Facts(
    vertical_datum="EPSG:3855",
    ce90=6.0,
    le90=4.0,
    licence="Copernicus DEM licence: free with credit",
    credit="produced using Copernicus WorldDEM-30 (c) DLR e.V. 2010-2014 and (c) Airbus Defence and Space GmbH "
    "2014-2018, provided under COPERNICUS by the European Union and ESA; all rights reserved",
)
# Accuracy is that of the product's specification. Only what its producer states, and holds everywhere, is here: datums
# of projects with several (3DEP) and accuracies that differ from place to place are left to the user.
KNOWN = (
    # Copernicus DEM product handbook: absolute, below 4 m (90 %) vertically and 6 m (90 %) horizontally.
    Known(
        ("cop-dem-glo-30", "cop-dem-glo-90", "copernicus_dsm", "copernicus-dem-30m", "copernicus-dem-90m"), _COPERNICUS
    ),
    # Specification of the mission: 16 m and 20 m (90 %), absolute.
    Known(("srtmgl1", "srtmgl3"), Facts("EPSG:5773", 20.0, 16.0, "public domain", "NASA and USGS, SRTM")),
    # JAXA states 5 m, root mean square, which is no level of confidence of CE90 and LE90.
    Known(("alos-dem", "aw3d30"), Facts("EPSG:5773", None, None, "JAXA's terms: free with credit", "(c) JAXA, AW3D30")),
    # Specification: 95 % of well-defined points within 6 m; a circular normal error has CE90 = 0.877 CE95.
    Known(("naip",), Facts(None, 5.3, None, "public domain", "USDA, National Agriculture Imagery Program")),
    # Product page: 0.2 m in plan and 0.1 m in height, one standard deviation: CE90 = 2.146, LE90 = 1.645 of them.
    Known(("swisssurface3d",), Facts("EPSG:5728", 0.43, 0.16, "open data: free with credit", "(c) swisstopo")),
    Known(("swissimage", "swissalti3d"), Facts(None, None, None, "open data: free with credit", "(c) swisstopo")),
)


def known_facts(*names: str) -> Facts:
    """What the table knows of a source by its address, collection or name of a file."""
    text = " ".join(names).lower()
    return next((one.facts for one in KNOWN if any(word in text for word in one.words)), Facts())


def joined(facts: Iterable[Facts]) -> Facts:
    """Of several parts of one source: what they agree on, all licences and credits, and the range of their dates."""
    found = list(facts)

    def common(name: str) -> float | str | None:
        values = {getattr(one, name) for one in found}
        return values.pop() if len(values) == 1 else None

    def every(name: str) -> str | None:
        return "; ".join(dict.fromkeys(value for one in found if (value := getattr(one, name)))) or None

    dates = sorted(date for one in found if one.date for date in one.date.split("/"))
    date = None if not dates else dates[0] if dates[0] == dates[-1] else f"{dates[0]}/{dates[-1]}"
    same = {name: common(name) for name in ("vertical_datum", "ce90", "le90")}
    return Facts(**same, licence=every("licence"), credit=every("credit"), date=date)  # type: ignore[arg-type]
