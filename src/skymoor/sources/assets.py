# SPDX-License-Identifier: Apache-2.0
"""The asset of a STAC item that is an orthophoto or a DSM, and what the item says about it."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatch
from typing import Any

from pystac import Asset, Item, Provider

from skymoor.errors import InputError
from skymoor.sources.known import Facts, Kind, known_facts
from skymoor.sources.stac import date_of, stac_errors

RASTER_TYPES = ("image/tiff", "image/jp2", "image/vnd.stac.geotiff", "application/x-geotiff")
RASTER_SUFFIXES = (".tif", ".tiff", ".jp2", ".vrt")
ASIDE = ("thumbnail", "overview", "metadata")
NAMES = {
    "ortho": ("visual", "rgb", "image", "ortho", "tci"),
    "dsm": ("dsm", "surface", "dem", "elevation", "height", "data"),
}
MOST_LISTED = 12


def asset_of(item: Item, kind: Kind, name: str) -> str:
    """The address of the asset of an item: that of a name or pattern, else the only one that fits best.

    Rasters count, and not previews. Better is, for an orthophoto, one with red, green and blue or the role "visual",
    and for a DSM one that is called so; of those the finest. Raises `InputError` with the names where it is not clear.
    """
    if name:
        found = {key: asset for key, asset in item.assets.items() if fnmatch(key, name)}
        how = f"no asset is called {name}" if not found else f"several assets are called {name}"
    else:
        found = {key: asset for key, asset in item.assets.items() if _is_raster(asset)}
        how = "no asset is clearly the orthophoto" if kind == "ortho" else "no asset is clearly the DSM"
        best = max((_fit(key, asset, kind) for key, asset in found.items()), default=0)
        found = {key: asset for key, asset in found.items() if _fit(key, asset, kind) == best}
        finest = min((_gsd(asset) for asset in found.values()), default=0.0)
        found = {key: asset for key, asset in found.items() if _gsd(asset) == finest}
    if len(found) != 1:
        listed = ", ".join(list(item.assets)[:MOST_LISTED]) or "none"
        raise InputError(f"STAC item {item.id}: {how}; add #NAME to the address, one of: {listed}")
    href = next(iter(found.values())).get_absolute_href()
    if href is None:
        raise InputError(f"STAC item {item.id}: the address of its asset is relative, and to what is not known")
    return str(href)


def facts_of(item: Item, address: str) -> Facts:
    """Date, licence and credit that an item, or its collection, states; datum and accuracy by the table of sources."""
    collection = None
    if item.collection_id is not None or item.get_single_link("collection"):
        # Facts are an extra: without the collection the item's own count.
        try:
            with stac_errors(address):
                collection = item.get_collection()
        except InputError:
            collection = None
    licence = item.properties.get("license") or (collection.license if collection else None)
    providers = item.common_metadata.providers or (collection.providers if collection else None) or []
    stated = Facts(
        licence=_licence(licence, item, collection), credit=_credit(providers), date=date_of(item)[:10] or None
    )
    return stated.or_else(known_facts(item.collection_id or "", address))


def _is_raster(asset: Asset) -> bool:
    if any(role in ASIDE for role in asset.roles or ()):
        return False
    if asset.media_type:
        return asset.media_type.lower().startswith(RASTER_TYPES)
    return asset.href.lower().split("?")[0].endswith(RASTER_SUFFIXES)


def _fit(key: str, asset: Asset, kind: Kind) -> int:
    """How clearly an asset is what is looked for."""
    roles = [role.lower() for role in asset.roles or ()]
    if kind == "ortho":
        bands = asset.extra_fields.get("eo:bands") or asset.extra_fields.get("bands") or []
        colours = {band.get("common_name") or band.get("eo:common_name") for band in bands}
        if {"red", "green", "blue"} <= colours or "visual" in roles:
            return 3
    words = f"{key} {asset.title or ''}".lower()
    if any(name in words for name in NAMES[kind]):
        return 2
    return 1 if "data" in roles else 0


def _gsd(asset: Asset) -> float:
    fields = asset.extra_fields
    found = fields.get("gsd") or fields.get("eo:gsd") or fields.get("raster:spatial_resolution") or 0.0
    return float(found)


def _licence(name: str | None, item: Item, collection: Any) -> str | None:
    """With the address of its text where the name alone says nothing."""
    if name not in ("proprietary", "other", "various", None):
        return name
    links = [link for holder in (item, collection) if holder is not None for link in holder.get_links("license")]
    return str(links[0].get_href()) if links else name


def _credit(providers: Sequence[Provider]) -> str | None:
    makers = [one.name for one in providers if set(one.roles or ()) & {"producer", "licensor"}]
    return ", ".join(makers or [one.name for one in providers]) or None
