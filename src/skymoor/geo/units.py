# SPDX-License-Identifier: Apache-2.0
"""Units of heights, by the names that rasters give to them."""

from __future__ import annotations

import re
from functools import lru_cache

from pyproj.database import get_units_map

US_SURVEY_FOOT_M = 1200.0 / 3937.0
# By EPSG's name of the unit, or its length in metres where their database has it rounded or, of the decimetre, wrong.
_ALIASES: dict[str | float, str] = {
    "metre": "m, metres, meter, meters",
    "millimetre": "millimetres, millimeter, millimeters",
    "centimetre": "centimetres, centimeter, centimeters",
    0.1: "dm, decimetre, decimetres, decimeter, decimeters",
    "kilometre": "kilometres, kilometer, kilometers",
    "foot": "feet, foot international, feet international, international foot, international feet, ift, intl ft",
    US_SURVEY_FOOT_M: (
        "us survey foot, us survey feet, us survey ft, us ft, usft, ftus, us foot, us feet, ft us, foot us, feet us, "
        "foot us survey, feet us survey, survey foot, survey feet, sft"
    ),
    "yard": "yards",
}


def unit_m(name: str) -> float | None:
    """Length in metres of a unit by any of its usual names, such as "m", "[ft]" or "US Feet"; None if it is unknown.

    The units of EPSG and PROJ are known by their names and short names; case, brackets and hyphens do not count.
    """
    return _units().get(_folded(name))


@lru_cache(maxsize=1)
def _units() -> dict[str, float]:
    table: dict[str, float] = {}
    for name, unit in get_units_map(category="linear").items():
        for known in filter(None, (name, unit.proj_short_name)):
            table.setdefault(_folded(known), float(unit.conv_factor))
    for unit_or_m, names in _ALIASES.items():
        length = table[unit_or_m] if isinstance(unit_or_m, str) else unit_or_m
        table.update(dict.fromkeys(map(_folded, names.split(",")), length))
    return table


def _folded(name: str) -> str:
    return " ".join(re.sub(r"[\[\](){}_.\-]", " ", name).lower().split())
