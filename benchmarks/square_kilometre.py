# SPDX-License-Identifier: Apache-2.0
"""Time and verdict of the hypothesis search in a square kilometre of distractors.

    python benchmarks/square_kilometre.py RUN SITE.toml [OTHER_ORTHO OTHER_DSM]

The site's reference is put at a random place into a mosaic of mirrored copies of itself (which no rotation makes equal
to it) and of another place. RUN is a finished run of the site.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from skymoor.match import search_hypotheses
from skymoor.pipeline.site import load_site
from skymoor.reference.read import read_reference
from skymoor.types import Raster, Reference


def main() -> None:
    run, site = Path(sys.argv[1]), load_site(Path(sys.argv[2]))
    files = site.reference
    own = read_reference(files.ortho, files.dsm, files.vertical_datum, files.covariance)
    pieces = [own]
    if len(sys.argv) > 4:
        pieces.append(
            read_reference(Path(sys.argv[3]), Path(sys.argv[4]), "ellipsoid", np.eye(3), pixel_m=own.grid.pixel_m)
        )
    with np.load(next((run / "renders").glob("*_nadir.npz"))) as render:
        rgb, xyz, confidence = render["rgb"], render["xyz"], render["confidence"]
    pixel = float(np.nanmedian(np.diff(xyz[..., 0], axis=1)))
    heights = np.where(confidence >= 0.2, xyz[..., 2] / pixel, np.nan).astype(np.float32)
    picture = Raster(rgb, np.isfinite(xyz[..., 2]), heights)
    mosaic, corner = make_mosaic(own, pieces, np.random.default_rng(1))
    per_metre = pixel / own.grid.pixel_m
    start = time.perf_counter()
    found = search_hypotheses(picture, mosaic, min_scale=20 * per_metre, max_scale=200 * per_metre)
    print(f"{mosaic.mask.shape} pixels of {own.grid.pixel_m:.2f} m: {time.perf_counter() - start:.1f} s")
    for p in found[:3]:
        u, v = np.array(p.centre_px) - corner
        inside = 0 <= u < own.mask.shape[1] and 0 <= v < own.mask.shape[0]
        print(f"  score {p.score:.0f}, height {p.scale / per_metre:.1f} m, {'on' if inside else 'off'} the true piece")


def make_mosaic(own: Reference, pieces: list[Reference], rng: np.random.Generator) -> tuple[Raster, np.ndarray]:
    side = round(1000 / own.grid.pixel_m)
    rgb, mask = np.zeros((side, side, 3), np.uint8), np.zeros((side, side), bool)
    height = np.full((side, side), np.nan, np.float32)

    def put(piece: Reference, v: int, u: int, turns: int | None) -> tuple[int, int]:
        layers = [piece.rgb, piece.mask, (piece.height - np.nanmedian(piece.height)) / own.grid.pixel_m]
        if turns is not None:
            layers = [np.rot90(x[:, ::-1], turns) for x in layers]
        h, w = min(layers[1].shape[0], side - v), min(layers[1].shape[1], side - u)
        for canvas, layer in zip((rgb, mask, height), layers, strict=True):
            canvas[v : v + h, u : u + w] = layer[:h, :w]
        return layers[1].shape[0], layers[1].shape[1]

    v = 0
    while v < side:
        u, tallest = 0, 0
        while u < side:
            h, w = put(pieces[rng.integers(len(pieces))], v, u, int(rng.integers(4)))
            u, tallest = u + w, max(tallest, h)
        v += max(tallest - 20, 100)
    corner = [int(rng.integers(side - n - 1)) for n in own.mask.shape]
    put(own, corner[0], corner[1], None)
    return Raster(rgb, mask, height), np.array(corner[::-1])


if __name__ == "__main__":
    main()
