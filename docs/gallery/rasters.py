# SPDX-License-Identifier: Apache-2.0
"""Pictures of what a run wrote, and of the site that it was made of."""

from __future__ import annotations

from itertools import chain
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from gallery.run import Missing, Source, saved
from skymoor.results.mosaic import mosaic_of
from skymoor.results.report.renderings import height_figure
from skymoor.store import open_image

TILE, SHOWN_WALLS = 300, 2


def overview(source: Source, path: Path) -> None:
    """Nadir render, its heights, and the checkerboard with the reference."""
    name = _first(source)
    parts = [source.image(f"renders/{name}_nadir_{kind}.png") for kind in ("rgb", "height")]
    parts.append(source.image(f"matches/{name}_overlay.png"))
    height = min(one.height for one in parts)
    saved(_row([one.resize((round(one.width * height / one.height), height)) for one in parts]), path, 1219)


def overlay(source: Source, path: Path) -> None:
    """Registered model and reference in alternate squares."""
    saved(source.image(f"matches/{_first(source)}_overlay.png"), path, 800)


def residuals(source: Source, path: Path) -> None:
    """Residuals of the inliers."""
    saved(source.image(f"matches/{_first(source)}_residuals.png"), path, 800)


def walls(source: Source, path: Path) -> None:
    """Facades by ground photos, from the air, and both in checkerboard."""
    found = sorted((source.folder / "matches").glob("*_walls.png"))
    if not found:
        raise Missing("the run has no ground photos that were registered by walls")
    picture = source.image(f"matches/{found[0].name}")
    gaps = np.flatnonzero((np.asarray(picture) > 245).all(axis=(1, 2)))  # white lines between the walls
    ends = [int(row) for row, after in zip(gaps, [*gaps[1:], picture.height], strict=True) if after > row + 1]
    if len(ends) >= SHOWN_WALLS:
        picture = picture.crop((0, 0, picture.width, ends[SHOWN_WALLS - 1]))
    saved(picture, path, 1000)


def simulated(source: Source, path: Path) -> None:
    """Two photos of each set, the orthophoto and the heights of the reference."""
    names = chain.from_iterable(_two_of(source, one["set"]) for one in source.result.summary["sets"])
    tiles = []
    for name in names:
        with open_image(source.result.photo(name)) as photo:
            tiles.append(ImageOps.fit(photo.convert("RGB"), (TILE, TILE)))
    mosaic = mosaic_of(source.result)
    if mosaic.satellite is None or mosaic.satellite_height is None:
        raise Missing(mosaic.note)
    rasters = (mosaic.satellite, height_figure(mosaic.satellite_height))
    tiles += [ImageOps.fit(Image.fromarray(one), (TILE, TILE)) for one in rasters]
    saved(_row(tiles), path, 1629)


def _two_of(source: Source, name: str) -> list[str]:
    images = [row.image for row in source.result.cameras if row.set == name]
    return images[:: max(1, len(images) // 2)][:2]


def _first(source: Source) -> str:
    found = [one.name for one in source.result.components if one.registered]
    if not found:
        raise Missing("nothing of the run is registered")
    return found[0]


def _row(tiles: list[Image.Image]) -> Image.Image:
    canvas = Image.new("RGB", (sum(one.width for one in tiles) + 4 * (len(tiles) - 1), tiles[0].height), "white")
    left = 0
    for one in tiles:
        canvas.paste(one, (left, 0))
        left += one.width + 4
    return canvas
