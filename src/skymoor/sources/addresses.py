# SPDX-License-Identifier: Apache-2.0
"""Addresses of rasters: what is one, its name for GDAL, and what of it may be written down."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import PurePosixPath
from urllib.parse import urlsplit
from xml.sax.saxutils import unescape

SCHEMES = {"http": "/vsicurl/http://", "https": "/vsicurl/https://", "s3": "/vsis3/", "gs": "/vsigs/"}
STAC, WMTS = "stac+", "WMTS:"
_ADDRESS = re.compile(rf"({'|'.join(SCHEMES)})://|/vsi[a-z0-9_]+[/?]|{re.escape(STAC)}https?://|{WMTS}", re.IGNORECASE)
_TEMPLATE = re.compile(r"\{-?[xyz]\}")
_NETWORK = ("/vsicurl", "/vsis3", "/vsigs", "/vsiaz", "/vsiadls", "/vsioss", "/vsiswift", "/vsiwebhdfs")


@dataclass(frozen=True)
class Addressed:
    """Sources of a reference, of which at least one is an address; `dsm` is None where heights are not fetched."""

    ortho: str
    dsm: str | None


def is_address(text: str) -> bool:
    """Whether a text is an address and no path: https://, http://, s3://, gs://, /vsi..., stac+https:// or WMTS:."""
    return _ADDRESS.match(text) is not None


def is_template(text: str) -> bool:
    """Whether it is the address of a tile service, with {x}, {y} and {z}."""
    return is_address(text) and {part.strip("{-}") for part in _TEMPLATE.findall(text)} == {"x", "y", "z"}


def is_catalogue(text: str) -> bool:
    """Whether an address is read as STAC: it begins with stac+, ends in .json, or its last part has no suffix."""
    if text.startswith(STAC):
        return True
    parts = urlsplit(text)
    suffix = PurePosixPath(parts.path).suffix.lower()
    # Collections and items of an API may be called "v1.0" or so: what is no suffix of a raster is a name there.
    named = suffix in ("", ".json", ".geojson") or ("/collections/" in parts.path and not suffix[1:].isalpha())
    return parts.scheme in ("http", "https") and named


def gdal_name(text: str) -> str:
    """The name of an address, or of a local file, for GDAL."""
    scheme, separator, rest = text.partition("://")
    return SCHEMES[scheme.lower()] + rest if separator and scheme.lower() in SCHEMES else text


def web_address(name: str) -> str | None:
    """The address on the web that GDAL reads under this name; None where there is none that anyone may ask."""
    if name.startswith(("/vsis3", "/vsigs", "<")):
        return None
    found = re.search(r"https?://[^\s\"'<>]+", name.partition(",layer=")[0])
    return found[0] if found else None


def failed_tile(name: str, text: str) -> str | None:
    """The address of the tile that GDAL could not read, by the name of its service and GDAL's message."""
    server, level = re.search("<ServerUrl>(.*)</ServerUrl>", name), re.search(r"<TileLevel>(\d+)<", name)
    place = re.search(r"X offset (\d+), Y offset (\d+)", text)
    if not (server and level and place):
        return None
    row = int(place[2]) if "<YOrigin>top<" in name else 2 ** int(level[1]) - 1 - int(place[2])
    address = unescape(server[1]).replace("${x}", place[1]).replace("${y}", str(row))
    return address.replace("${z}", level[1])


def public_address(text: str) -> str:
    """An address without user, password and query, which may hold keys: what is shown and written down."""
    shown = re.sub(r"(://)[^/@\s]*@", r"\1", text)
    head, _, asset = shown.partition("#")
    return re.sub(r"\?[^\s'\"<>]*", "", head) + (f"#{asset}" if asset else "")


def reads_network(name: str) -> bool:
    """Whether GDAL reads this name over the network."""
    return name.lower().startswith(_NETWORK) or name.startswith((WMTS, "<GDAL_WMS"))
