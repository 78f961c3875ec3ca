# SPDX-License-Identifier: Apache-2.0
"""The JSON schema of site.toml, made of the options themselves."""

from __future__ import annotations

from dataclasses import is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from skymoor.pipeline.option_docs import descriptions_of
from skymoor.pipeline.option_parser import option_fields
from skymoor.pipeline.options import Options

PLAIN = {float: "number", int: "integer", bool: "boolean", str: "string", Path: "string"}


def site_schema() -> dict[str, Any]:
    """For editors that complete and check site.toml (JSON Schema, draft 2020-12)."""
    metres = {"type": "number", "exclusiveMinimum": 0}
    row = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
    reference = {
        "ortho": {"type": "string", "description": "orthophoto, any CRS that GDAL reads, or its address"},
        "dsm": {
            "type": ["string", "number"],
            "description": "its surface model, or one height of the ground in metres; without it heights stay unknown",
        },
        "run": {"type": "string", "description": "folder of an earlier run, in place of all the others"},
        "vertical_datum": {"type": "string", "description": '"ellipsoid" or an EPSG code such as "EPSG:3855"'},
        "ce90": {**metres, "description": "circular error, 90 percent, metres"},
        "le90": {**metres, "description": "linear (vertical) error, 90 percent, metres"},
        "accuracy": {"const": "unknown", "description": "in place of ce90 and le90, where nobody knows them"},
        "covariance": {"type": "array", "items": row, "minItems": 3, "maxItems": 3},
        "licence": {"type": "string", "description": "of the reference; goes into the summary, report and exports"},
        "credit": {"type": "string", "description": "whom to name, as the licence asks"},
        "date": {"type": "string", "description": "when the orthophoto was taken"},
    }
    source = {"type": "string", "description": "folder of photos with its sub-folders, or a video"}
    several = {"type": "array", "items": source, "minItems": 1}
    images = _table({"images": {"anyOf": [source, several]}}, required=["images"])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A site of skymoor",
        **_table(
            {
                "name": {"type": "string"},
                "reference": {**_table(reference), "anyOf": [{"required": ["ortho"]}, {"required": ["run"]}]},
                "airborne": images,
                "ground": {"type": "array", "items": images},
                "control": _table(_control(metres), required=["files"]),
                "prior": _table(_prior(metres)),
                "options": _options(Options()),
            },
            required=["reference"],
        ),
    }


def _control(metres: dict[str, Any]) -> dict[str, Any]:
    file = {"type": "string", "description": "gcp_list.txt or geo.txt of ODM, or a table of points or scale bars"}
    return {
        "files": {"anyOf": [file, {"type": "array", "items": file, "minItems": 1}]},
        "use": {"type": "boolean", "description": "move the models onto it; otherwise they are compared with it"},
        "crs": {"type": "string", "description": "of x and y in tables"},
        "vertical_datum": {"type": "string", "description": '"ellipsoid" or an EPSG code'},
        "ce90": {**metres, "description": "circular error, 90 percent, metres, where the files do not say"},
        "le90": {**metres, "description": "linear error, 90 percent, metres, where the files do not say"},
    }


def _prior(metres: dict[str, Any]) -> dict[str, Any]:
    def numbers(count: int, about: str) -> dict[str, Any]:
        items = {"type": "number"}
        return {"type": "array", "items": items, "minItems": count, "maxItems": count, "description": about}

    return {
        "area": numbers(4, "search only there: west, south, east and north in degrees"),
        "near": numbers(3, "search only there: latitude, longitude and a radius in metres"),
        "heading": {
            "type": ["string", "number"],
            "description": "compass direction in which the first photo looks, degrees, or PHOTO=DEGREES",
        },
        "height": {**metres, "description": "flying height above the ground, metres"},
    }


def _table(properties: dict[str, Any], *, required: list[str] | None = None) -> dict[str, Any]:
    table: dict[str, Any] = {"type": "object", "properties": properties, "additionalProperties": False}
    return {**table, "required": required} if required else table


def _options(config: Any) -> dict[str, Any]:
    hints, described = get_type_hints(type(config)), descriptions_of(type(config))
    properties: dict[str, Any] = {}
    for item in option_fields(config):
        value = getattr(config, item.name)
        if is_dataclass(value):
            properties[item.name] = _options(value)
        else:
            about = {"description": described[item.name]} if item.name in described else {}
            properties[item.name] = {**_kind(hints[item.name]), "default": value, **about}
    return _table(properties)


def _kind(annotation: Any) -> dict[str, Any]:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin in (Union, UnionType):
        return {"anyOf": [_kind(one) if one is not NoneType else {"const": "none"} for one in arguments]}
    if origin is tuple:
        return {"type": "array", "items": _kind(arguments[0])}
    return {"type": PLAIN[annotation]}
