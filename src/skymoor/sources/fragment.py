# SPDX-License-Identifier: Apache-2.0
"""reference.toml: the table [reference] of a site.toml for a reference that was fetched."""

from __future__ import annotations

import json
from collections.abc import Mapping

from skymoor.sources.copying import Copied
from skymoor.sources.known import Facts
from skymoor.sources.layers import Layer
from skymoor.sources.stac import BBox

TABLE = "reference.toml"


def reference_table(facts: Facts, fetched: Mapping[str, tuple[Layer, Copied]], bbox: BBox | None) -> str:
    """The text of the file, with the sources by the names of their files.

    What is not known is a comment that says what to fill in.
    """
    lines = ["# Written by skymoor reference. With the photos it is a site.toml: see the end."]
    if bbox is not None:
        lines.append(f"# Bounding box (west, south, east, north): {' '.join(f'{side:.6f}' for side in bbox)}")
    lines += [f"# {name}: {layer.shown}, pixel {copied.pixel_m:.2g} m" for name, (layer, copied) in fetched.items()]
    lines += ["[reference]", *(f'{name.removesuffix(".tif")} = "{name}"' for name in fetched)]
    if "dsm.tif" in fetched:
        lines += _datum(facts.vertical_datum)
    lines += _accuracy(facts, heights="dsm.tif" in fetched)
    lines += [_text("licence", facts.licence), _text("credit", facts.credit), _text("date", facts.date)]
    return "\n".join([*lines, "", "# [airborne]", '# images = "photos"']) + "\n"


def _datum(datum: str | None) -> list[str]:
    if datum is None:
        return [
            "# The source does not state what its heights refer to: look it up and remove the #. It is",
            '# "ellipsoid", or the EPSG code of a vertical CRS such as "EPSG:3855" (EGM2008).',
            '# vertical_datum = "EPSG:..."',
        ]
    return [_text("vertical_datum", datum)]


def _accuracy(facts: Facts, *, heights: bool) -> list[str]:
    known = [
        (name, value) for name, value in (("ce90", facts.ce90), ("le90", facts.le90 if heights else None)) if value
    ]
    if len(known) == (2 if heights else 1):
        return [f"{name} = {value}" for name, value in known]
    told = "".join(f" {name.upper()} of the source: {value} m." for name, value in known)
    return [
        f"# The accuracy is not known.{told} If you know it, write ce90 = and le90 = in metres (90 %) instead.",
        'accuracy = "unknown"',
    ]


def _text(key: str, value: str | None) -> str:
    # JSON's strings are TOML's basic strings, but for the delete character.
    quoted = json.dumps(value or "", ensure_ascii=False).replace("\x7f", "\\u007f")
    return f"{key} = {quoted}" if value else f"# {key} = "
