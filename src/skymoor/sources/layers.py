# SPDX-License-Identifier: Apache-2.0
"""From what the user names as an orthophoto or a DSM to the rasters that have to be read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from skymoor.errors import InputError
from skymoor.sources.addresses import STAC, gdal_name, is_address, is_catalogue, is_template, public_address
from skymoor.sources.assets import asset_of, facts_of
from skymoor.sources.known import Facts, Kind, joined, known_facts
from skymoor.sources.stac import HOW_TO_BOUND, BBox, Wanted, find_items
from skymoor.sources.tiles import PIXEL_M, tile_service, zoom_of

LOCAL_STAC = "a STAC catalogue on this machine is not read; give the path of its raster"


@dataclass(frozen=True)
class Layer:
    """One raster, or several that are laid beside each other, where the first counts.

    Attributes:
        shown: what the user gave, without keys.
        names: of the rasters, for GDAL.
        facts: what is known of them all.
        pixel_m: of an overview that is fine enough, or None for the finest.
        is_worldwide: it has no border, so that the part to be read must be said.
        labels: what errors call each raster, where it is not what the user gave.
    """

    shown: str
    names: tuple[str, ...]
    facts: Facts
    pixel_m: float | None = None
    is_worldwide: bool = False
    labels: tuple[str, ...] = ()

    def label(self, name: str) -> str:
        """What errors call a raster."""
        return self.labels[self.names.index(name)] if self.labels else self.shown


def layer_of(source: str, kind: Kind, wanted: Wanted, pixel_m: float | None) -> Layer:
    """What a source is: a file, an address of a raster, STAC, or a tile service. Raises `InputError` for others."""
    shown = public_address(source)
    if is_template(source):
        return _tiles(source, shown, kind, wanted.bbox, pixel_m)
    if not is_address(source):
        return _file(source, pixel_m)
    base, _, asset = source.partition("#")
    if is_catalogue(base):
        return _stac(base, asset, kind, wanted, pixel_m)
    if base.startswith(STAC):
        raise InputError(f"{shown}: STAC is read from https:// and http:// only")
    return Layer(shown, (gdal_name(source),), known_facts(shown), pixel_m)


def _file(source: str, pixel_m: float | None) -> Layer:
    if not Path(source).is_file():
        raise InputError(f"{source}: there is no such file, and it is no address (https://, s3://, WMTS:)")
    if Path(source).suffix.lower() in (".json", ".geojson"):
        raise InputError(f"{source}: {LOCAL_STAC}")
    return Layer(source, (source,), known_facts(Path(source).name), pixel_m)


def _tiles(source: str, shown: str, kind: Kind, bbox: BBox | None, pixel_m: float | None) -> Layer:
    if kind == "dsm":
        raise InputError(f"{shown}: tiles are images and hold no heights; give a raster of heights as the DSM")
    if bbox is None:
        raise InputError(f"{shown}: a tile service covers the world; say which part is needed: {HOW_TO_BOUND}")
    zoom = zoom_of(pixel_m or PIXEL_M, (bbox[1] + bbox[3]) / 2)
    return Layer(shown, (tile_service(source, zoom),), known_facts(shown), is_worldwide=True)


def _stac(base: str, asset: str, kind: Kind, wanted: Wanted, pixel_m: float | None) -> Layer:
    items = find_items(base, wanted)
    hrefs = [asset_of(item, kind, asset) for item in items]
    facts = joined(facts_of(item, base) for item in items)
    shown = public_address(f"{base}#{asset}" if asset else base)
    labels = tuple(public_address(href) for href in hrefs)
    return Layer(shown, tuple(gdal_name(href) for href in hrefs), facts, pixel_m, labels=labels)
