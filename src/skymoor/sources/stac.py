# SPDX-License-Identifier: Apache-2.0
"""STAC: the items of an address that lie in a bounding box, newest first."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pystac import Catalog, Item
from pystac.errors import STACError
from pystac_client import Client
from pystac_client.exceptions import APIError
from pystac_client.stac_api_io import StacApiIO
from pystac_client.warnings import PystacClientWarning
from rasterio import Affine
from rasterio.features import rasterize

from skymoor.errors import InputError
from skymoor.sources.addresses import STAC, public_address
from skymoor.sources.remote import RETRIES, TIMEOUT_S, reason_of, reason_of_status

BBox = tuple[float, float, float, float]
MOST_ITEMS = 1000
COVERAGE_PX = 128
HOW_TO_BOUND = "--bbox W S E N, in a run --area W S E N or --near"
_CAUSE = re.compile(r"(\[Errno|timed out|Failed to resolve|certificate verify)[^'\")]*")


@dataclass(frozen=True)
class Wanted:
    """What is asked of a catalogue: a bounding box (west, south, east, north), and times as STAC writes them."""

    bbox: BBox | None
    date: str | None


def find_items(address: str, wanted: Wanted) -> list[Item]:
    """The items of a STAC item, collection, catalogue or search that are needed to cover the bounding box.

    Of several that cover the same ground the newest counts. Raises `InputError` where the address holds no STAC, a
    collection is asked for without a bounding box, or nothing lies in it.
    """
    where = address.removeprefix(STAC)
    shown = public_address(where)
    with stac_errors(shown):
        io = StacApiIO(timeout=TIMEOUT_S, max_retries=RETRIES)
        content = io.read_json(where)
        if content.get("type") == "Feature" and "assets" in content:
            return [Item.from_dict(content, href=where)]
        if wanted.bbox is None:
            raise InputError(f"{shown}: holds many items; say which part is needed: {HOW_TO_BOUND}")
        found = sorted(_items(where, content, io, wanted), key=date_of, reverse=True)
    inside = [item for item in found if _is_within(item, wanted)]
    if not inside:
        when = f" and the time {wanted.date}" if wanted.date else ""
        raise InputError(f"{shown}: has no item in the bounding box{when}; check both")
    return _needed(inside, wanted.bbox)


def date_of(item: Item) -> str:
    """When its image was taken, as text that sorts by time; empty where it does not say."""
    properties = item.properties
    return str(properties.get("datetime") or properties.get("end_datetime") or properties.get("start_datetime") or "")


@contextmanager
def stac_errors(shown: str) -> Iterator[None]:
    """Turn the errors of pystac into an `InputError` that names the address."""
    try:
        with warnings.catch_warnings():
            # About links that a server lacks, and the versions of what it gives.
            warnings.filterwarnings("ignore", module="pystac.*")
            warnings.filterwarnings("ignore", category=PystacClientWarning)
            yield
    except APIError as error:
        code = getattr(error, "status_code", None)
        # The text of a server's error page says less than its status, and that of a failed connection is in its middle.
        inner = _CAUSE.search(str(error))
        told = reason_of_status(code) if code else reason_of(inner[0] if inner else str(error).split("\n")[0], "")
        raise InputError(f"{shown}: {told}") from None
    except (STACError, json.JSONDecodeError, KeyError, TypeError, AttributeError, ValueError, OSError) as error:
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"{shown}: cannot be read as a STAC item, collection or search ({public_address(text)}); check the address"
        ) from None


def _items(where: str, content: dict[str, Any], io: StacApiIO, wanted: Wanted) -> list[Item]:
    kind = content.get("type")
    links = {link.get("rel"): link.get("href") for link in content.get("links", [])}
    if kind == "FeatureCollection":
        pages = io.get_pages(where)
        return list(islice((Item.from_dict(one) for page in pages for one in page["features"]), MOST_ITEMS + 1))
    if kind == "Collection" and "items" in links and "root" in links:
        search = Client.open(links["root"], stac_io=io).search(
            method="GET",
            collections=[content["id"]],
            bbox=list(wanted.bbox or ()),
            datetime=wanted.date,
            max_items=MOST_ITEMS + 1,
        )
        return list(search.items())
    if kind == "Catalog" and "search" in links:
        raise InputError(
            f"{public_address(where)}: is a whole catalogue; give one of its collections, ADDRESS/collections/NAME"
        )
    if kind in ("Collection", "Catalog"):
        catalogue = Catalog.from_file if kind == "Catalog" else _collection_from_file
        return list(islice(catalogue(where, stac_io=io).get_items(recursive=True), MOST_ITEMS + 1))
    raise InputError(f"{public_address(where)}: is JSON, but no STAC item, collection or search; check the address")


def _collection_from_file(where: str, stac_io: StacApiIO) -> Catalog:
    from pystac import Collection

    return Collection.from_file(where, stac_io=stac_io)


def _is_within(item: Item, wanted: Wanted) -> bool:
    """In space and, where the server has not looked at it, in time."""
    if wanted.bbox is not None and item.bbox is not None:
        west, south, *_ = item.bbox
        east, north = item.bbox[len(item.bbox) // 2 : len(item.bbox) // 2 + 2]
        if east <= wanted.bbox[0] or west >= wanted.bbox[2] or north <= wanted.bbox[1] or south >= wanted.bbox[3]:
            return False
    if wanted.date is None:
        return True
    first, _, last = wanted.date.partition("/")
    last = last or first
    taken = date_of(item)
    return (first in ("", "..") or taken >= first) and (last in ("", "..") or taken[: len(last)] <= last)


def _needed(items: Sequence[Item], bbox: BBox) -> list[Item]:
    """Those that show ground which none before them shows."""
    if len(items) > MOST_ITEMS:
        raise InputError(f"over {MOST_ITEMS} items lie in the bounding box; give a smaller --bbox, or a --date")
    west, south, east, north = bbox
    rows, columns = COVERAGE_PX, COVERAGE_PX
    lonlat_from_px = Affine((east - west) / columns, 0.0, west, 0.0, (south - north) / rows, north)
    covered: NDArray[np.bool_] = np.zeros((rows, columns), bool)
    needed: list[Item] = []
    for item in items:
        outline = [(item.geometry or _rectangle(item), 1)]
        # The border of an outline runs through pixels that the item shows a part of: they are not covered for certain.
        touched, inside = (
            rasterize(outline, covered.shape, transform=lonlat_from_px, all_touched=every, dtype="uint8") > 0
            for every in (True, False)
        )
        if (touched & ~covered).any():
            needed.append(item)
            covered |= inside
    return needed


def _rectangle(item: Item) -> dict[str, Any]:
    west, south, east, north = item.bbox or (-180.0, -90.0, 180.0, 90.0)
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    return {"type": "Polygon", "coordinates": [ring]}
