# SPDX-License-Identifier: Apache-2.0
"""Time, memory and verdict of the search in 1 to 16 square kilometres of distractors.

    python benchmarks/large_areas.py RUN SITE.toml [--others ORTHO DSM]... [--areas 1 4 16] [--decoys]

The site's reference is put at a random place into a mosaic of mirrored copies of itself (which no rotation makes equal
to it) and of other places. RUN is a finished run of the site. With `--decoys` a shuffled one is searched as well.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import numpy as np

from skymoor.match.decoys import mixed
from skymoor.match.search import ReferencePyramid, SearchOptions, search_in
from skymoor.pipeline.site import load_site
from skymoor.reference.read import read_reference
from skymoor.types import Raster, Reference, no_progress

HEIGHTS_M = (30.0, 500.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("site", type=Path)
    parser.add_argument("--others", type=Path, nargs=2, action="append", default=[])
    parser.add_argument("--areas", type=float, nargs="*", default=[1.0, 4.0, 16.0], help="square kilometres")
    parser.add_argument("--decoys", action="store_true")
    options = parser.parse_args()
    files = load_site(options.site).reference
    own = read_reference(files.ortho, files.dsm, files.vertical_datum, files.covariance)
    pixel_m = own.grid.pixel_m
    pieces = [own]
    pieces += [read_reference(a, b, "ellipsoid", np.eye(3), pixel_m=pixel_m) for a, b in options.others]
    picture, pixel = render_of(options.run)
    scales = [height * pixel / pixel_m for height in HEIGHTS_M]
    print(
        "| km2 | image | by | height m | score | next | at the place | features s | search s | peak GiB |\n|"
        + "---|" * 10
    )
    for area in options.areas:
        mosaic, corner = make_mosaic(own, pieces, round(1000 * np.sqrt(area) / pixel_m), np.random.default_rng(1))
        reference = ReferencePyramid(mosaic)
        start = time.process_time()
        count = len(reference.features)
        prepared = time.process_time() - start
        for name, image in [
            ("render", picture),
            *([("shuffled", mixed(picture, 4, np.random.default_rng(0)))] if options.decoys else []),
        ]:
            start = time.process_time()
            limits = {"min_scale": scales[0], "max_scale": scales[1], "options": SearchOptions()}
            found = search_in(reference, image, **limits, progress=no_progress)
            seconds = time.process_time() - start
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            best, second = found[0], found[1].score if len(found) > 1 else float("nan")
            u, v = np.array(best.centre_px) - corner
            inside = 0 <= u < own.mask.shape[1] and 0 <= v < own.mask.shape[0]
            how = "features" if best.by_features else "all places"
            height = best.scale / pixel * pixel_m
            cells = [f"{area:g}", name, how, f"{height:.1f}", f"{best.score:.0f}", f"{second:.0f}"]
            cells += ["yes" if inside else "no", f"{prepared:.0f} ({count})", f"{seconds:.0f}", f"{peak:.1f}"]
            print("| " + " | ".join(cells) + " |", flush=True)


def render_of(run: Path) -> tuple[Raster, float]:
    """The nadir render of a run, and its pixel in units of the level frame."""
    with np.load(next((run / "renders").glob("*_nadir.npz"))) as render:
        rgb, xyz, confidence = render["rgb"], render["xyz"], render["confidence"]
    pixel = float(np.nanmedian(np.diff(xyz[..., 0], axis=1)))
    heights = np.where(confidence >= 0.2, xyz[..., 2] / pixel, np.nan).astype(np.float32)
    return Raster(rgb, np.isfinite(xyz[..., 2]), heights), pixel


def make_mosaic(
    own: Reference, pieces: list[Reference], side: int, rng: np.random.Generator
) -> tuple[Raster, np.ndarray]:
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
