# SPDX-License-Identifier: Apache-2.0
"""How often right hypotheses are accepted and wrong ones refused: windows of models in own and other references.

    python benchmarks/refusal.py RUN=SITE.toml [RUN=SITE.toml ...] [--elsewhere ORTHO=DSM] [--windows 40]
        [--seed 6] [--results FILE]

RUN is the folder of a finished run that is known to be right, SITE.toml what it was run on. From each run's
nadir render windows of random place, size and shape are cut, and turned, brightened and made noisy at random. Each is
registered in its own reference by search, decoys, matching and decision of the product: a true case, and
right if the window's own points come within two metres (median) of where the whole model's registration puts them.
Each of its decoys, which match nowhere, is then registered in the same way, with the others for its decoys: a wrong
case, harder than another site would be, as it looks like the window itself.
Every sixth window is also searched where nothing is right: in its own reference mirrored, in that of another site, and
in its own with heights of elsewhere. Results are the shares that are accepted at the product's limits, and the same for
limits on the false-alarm probability alone (the ROC). A results file that exists is continued.
"""

from __future__ import annotations

import argparse
import json
import time
import zlib
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from paper_tables import provenance

from skymoor.geometry import Similarity, umeyama
from skymoor.match import DecoyOptions, SearchOptions
from skymoor.match.decoys import make_decoys, mirrored
from skymoor.match.rasters import nadir_raster, reference_raster
from skymoor.match.reference_pyramid import ReferencePyramid
from skymoor.match.search import search_in
from skymoor.pipeline.options import Options
from skymoor.pipeline.register_best import Prior, Steps, register_hypothesis
from skymoor.pipeline.site import load_site
from skymoor.reference.read import read_reference
from skymoor.registration import NullSample, decide
from skymoor.types import Raster, Reference, Registration, Render, View, no_progress

Array = NDArray[np.float64]
RIGHT_M = 2.0
# Some hundred searches have to be cheap: at a third of the product's resolution, over few scales, with few decoys. True
# places are harder to tell from chance so, for the scores of both are of fewer pixels.
SEARCH = SearchOptions(azimuth_step_deg=8.0, reference_px=160, template_px=64, keep=4, fine_px=256)
DECOYS = DecoyOptions(count=5)
OPTIONS = Options()
MATCH = OPTIONS.match
STEPS = Steps(
    OPTIONS.engines.dense_matcher(MATCH.matcher),
    MATCH.cyclic,
    OPTIONS.lift,
    OPTIONS.register,
    MATCH.min_height_confidence,
)
PRIOR = Prior(1.0, None)
SCALE_RANGE = 1.15


@dataclass(frozen=True, eq=False)
class Model:
    """A placed model: its render in level units, where it is, its reference and the photos' height range."""

    name: str
    render: Render
    enu_from_level: Similarity
    reference: Reference


def model_of(run: Path, site: Path) -> Model:
    """The first airborne component of a finished run; the level frame is as the render says it, in metres of ENU."""
    summary = json.loads((run / "summary.json").read_text())
    component = summary["sets"][0]["components"][0]
    assert component["status"] == "REGISTERED", run
    files = load_site(site).reference
    reference = read_reference(files.ortho, files.dsm, files.vertical_datum, files.covariance, pixel_m=0.6)
    arrays = np.load(run / "renders/airborne_0_nadir.npz")
    matches = np.load(run / "matches/airborne_0.npz")
    inliers = matches["inliers"]
    inliers &= np.isfinite(matches["xyz_enu"]).all(axis=1)
    placed = umeyama(matches["xyz_level"][inliers], matches["xyz_enu"][inliers])
    xyz = arrays["xyz"]
    known = np.isfinite(xyz[..., 0])
    rows, columns = np.nonzero(known)
    pixel = float(np.median(np.abs(np.diff(xyz[..., 0], axis=1)[known[:, 1:] & known[:, :-1]])))
    x0 = float(np.median(xyz[rows, columns, 0] - (columns + 0.5) * pixel))
    y0 = float(np.median(-xyz[rows, columns, 1] - (rows + 0.5) * pixel))
    # Every second pixel: what is searched and matched here is coarser anyway.
    rgb, xyz, confidence = (arrays[name][::2, ::2] for name in ("rgb", "xyz", "confidence"))
    view = View(np.diag([1.0, -1.0, -1.0]), x0 - pixel / 2, y0 - pixel / 2, 2 * pixel, confidence.shape)
    name = run.parent.name if run.name == "result" else run.name
    return Model(name, Render(view, rgb, xyz, confidence), placed, reference)


def window(model: Model, rng: np.random.Generator) -> Render | None:
    """A part of the render on another day; None where it shows too little."""
    h, w = model.render.confidence.shape
    rows, columns = (round(side * rng.uniform(0.4, 0.8)) for side in (h, w))
    top, left = rng.integers(0, h - rows + 1), rng.integers(0, w - columns + 1)
    part = np.s_[top : top + rows, left : left + columns]
    xyz, view = model.render.xyz[part], model.render.view
    if np.isfinite(xyz[..., 0]).mean() < 0.7:
        return None
    rgb = 255 * (model.render.rgb[part] / 255.0) ** rng.uniform(0.6, 1.6)
    rgb = np.clip(rgb * rng.uniform(0.7, 1.2) + rng.normal(scale=rng.uniform(2, 12), size=rgb.shape), 0, 255)
    cut = replace(view, x0=view.x0 + left * view.pixel, y0=view.y0 + top * view.pixel, shape=(rows, columns))
    return Render(cut, rgb.astype(np.uint8), xyz, model.render.confidence[part])


def registered_in(
    render: Render, reference: Reference, metres: float, rng: np.random.Generator
) -> tuple[Registration, list[Registration]]:
    """Registration of the render as in the pipeline, and so of each of its decoys, with the others for its decoys.

    Scales are searched within `SCALE_RANGE` of the true one.
    """
    picture, target = as_raster(render), reference_raster(reference)
    px = render.view.pixel * metres / reference.grid.pixel_m
    scales = {"min_scale": px / SCALE_RANGE, "max_scale": px * SCALE_RANGE}
    sized = ReferencePyramid(target)
    renders = [render, *(as_render(decoy, render.view) for decoy in make_decoys(picture, DECOYS))]
    places = [search_in(sized, as_raster(one), **scales, options=SEARCH, progress=no_progress) for one in renders]
    if not places[0]:
        return Registration(registered=False, reason="too small", enu_from_level=None), []
    tried = [
        (found, register_hypothesis(found[0], (as_raster(one), target), one, reference, PRIOR, STEPS, rng=rng))
        for one, found in zip(renders, places, strict=True)
        if found
    ]
    samples = [NullSample(found[0].score, candidate.agreement) for found, candidate in tried]
    decided = []
    for k, (found, one) in enumerate(tried):
        scores = [hypothesis.score for hypothesis in found]
        null = [sample for j, sample in enumerate(samples) if j not in (0, k)]
        evidence = {"agreement": one.agreement, "decoys": null}
        decided.append(decide(one.registration, scores, one.n_matches_2d, OPTIONS.register, **evidence))
    return decided[0], decided[1:]


def as_raster(render: Render) -> Raster:
    """What of a render is searched and matched."""
    return nadir_raster(render, MATCH.min_height_confidence)


def as_render(decoy: Raster, view: View) -> Render:
    """A decoy as if a model had been rendered so."""
    rows, columns = np.indices(decoy.mask.shape)
    x, y = view.x0 + (columns + 0.5) * view.pixel, -(view.y0 + (rows + 0.5) * view.pixel)
    heights = decoy.height if decoy.height is not None else np.zeros(decoy.mask.shape)
    known = decoy.mask & np.isfinite(heights)
    xyz = np.where(known[..., None], np.stack([x, y, heights * view.pixel], axis=-1), np.nan).astype(np.float32)
    return Render(view, decoy.rgb, xyz, known.astype(np.float32))


def row_of(model: Model, number: int, kind: str, found: Registration, render: Render | None) -> dict[str, object]:
    """One case; `render` where an error is known."""
    return {
        "model": model.name,
        "window": number,
        "kind": kind,
        "registered": found.registered,
        "reason": found.reason,
        "heights": None if found.heights is None else found.heights.status,
        "error_m": error_m(render, found, model.enu_from_level) if render else None,
        **{key: found.diagnostics.get(key) for key in KEYS},
    }


def error_m(render: Render, found: Registration, truth: Similarity) -> float:
    """Median distance in plan of the window's points from where they are."""
    if found.enu_from_level is None:
        return float("inf")
    points = render.xyz[np.isfinite(render.xyz[..., 0])][::50].astype(np.float64)
    off = found.enu_from_level.apply(points) - truth.apply(points)
    return float(np.median(np.linalg.norm(off[:, :2], axis=1)))


def wrong_references(model: Model, others: list[Reference], rng: np.random.Generator) -> list[tuple[str, Reference]]:
    """Places where nothing is right."""
    own = model.reference
    flipped = mirrored(reference_raster(own))
    height = np.ascontiguousarray(own.height[:, ::-1])
    mirror = replace(own, rgb=flipped.rgb, mask=flipped.mask, height=height)
    other = others[int(rng.integers(len(others)))]
    heights = cv2.resize(np.nan_to_num(other.height, nan=0.0), own.height.shape[::-1])
    return [("mirrored", mirror), ("another", other), ("heights of another", replace(own, height=heights))]


def cases_of(
    model: Model, number: int, render: Render, others: list[Reference], rng: np.random.Generator
) -> list[dict[str, object]]:
    """Rows of a window: in its own reference, its decoys there, and for every sixth where nothing is right."""
    cases = [("own", model.reference), *(wrong_references(model, others, rng) if number % 6 == 0 else [])]
    rows = []
    for kind, reference in cases:
        found, decoys = registered_in(render, reference, model.enu_from_level.scale, rng)
        rows.append(row_of(model, number, kind, found, None if kind == "another" else render))
        # Elsewhere the picture's own decoys say nothing new.
        rows += [row_of(model, number, "decoy", one, None) for one in decoys if kind == "own"]
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+")
    parser.add_argument("--elsewhere", help="orthophoto and DSM of a place where nothing is right")
    parser.add_argument("--windows", type=int, default=40)
    parser.add_argument("--seed", type=int, default=6)
    parser.add_argument("--results", type=Path)
    arguments = parser.parse_args()
    models = [model_of(*(Path(part) for part in pair.split("="))) for pair in arguments.runs]
    elsewhere = []
    if arguments.elsewhere:
        ortho, dsm = (Path(part) for part in arguments.elsewhere.split("="))
        elsewhere = [read_reference(ortho, dsm, "ellipsoid", np.eye(3), pixel_m=0.6)]
    kept = arguments.results and arguments.results.exists()
    rows = json.loads(arguments.results.read_text())["rows"] if kept else []
    done = {(row["model"], row["window"]) for row in rows}
    # Windows of all models in turn, so that an unfinished file is of all of them.
    for k, model in product(range(arguments.windows), models):
        rng = np.random.default_rng([arguments.seed, zlib.crc32(model.name.encode()), k])
        render = None if (model.name, k) in done else window(model, rng)
        if render is None:
            continue
        start, others = time.process_time(), [m.reference for m in models if m is not model] + elsewhere
        rows += cases_of(model, k, render, others, rng)
        print(f"{model.name} {k}: {time.process_time() - start:.0f} CPU s", flush=True)
        if arguments.results:
            text = json.dumps({**provenance(), "summary": told(rows), "rows": rows}, indent=1) + "\n"
            arguments.results.write_text(text)
    print(json.dumps(told(rows), indent=1))


KEYS = ("search_score", "second_score", "decoy_score", "false_alarm_probability", "cells", "covered_cells")


def told(rows: list[dict[str, object]]) -> dict[str, object]:
    """Shares believed, right and wrong, and the ROC of the probability of chance."""
    own = [row for row in rows if row["kind"] == "own"]
    wrong = [row for row in rows if row["kind"] in ("mirrored", "another")]
    decoyed = [row for row in rows if row["kind"] == "decoy"]
    # Heights of another place under the right colours: the place is right in plan, and may be so in height.
    half = [row for row in rows if row["kind"] == "heights of another"]

    def right(row: dict[str, object]) -> bool:
        return float(row["error_m"]) <= RIGHT_M  # type: ignore[arg-type]

    roc = []
    for limit in (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.001, 1e-4):
        passed = [[float(r["false_alarm_probability"] or 1.0) <= limit for r in part] for part in (own, wrong, decoyed)]  # type: ignore[arg-type]
        roc.append([limit, *(float(np.mean(p)) if p else None for p in passed)])
    return {
        "true cases": len(own),
        "believed": sum(bool(r["registered"]) for r in own),
        "believed and right": sum(bool(r["registered"]) and right(r) for r in own),
        "wrong places": len(wrong),
        "believed in wrong places": sum(bool(r["registered"]) for r in wrong),
        "heights of another place": len(half),
        "believed with those": sum(bool(r["registered"]) for r in half),
        "believed with those and wrong": sum(bool(r["registered"]) and not right(r) for r in half),
        "their heights confirmed": sum(bool(r["registered"]) and r["heights"] == "CONFIRMED" for r in half),
        "heights confirmed of the right ones": sum(bool(r["registered"]) and r["heights"] == "CONFIRMED" for r in own),
        "decoys": len(decoyed),
        "decoys believed": sum(bool(r["registered"]) for r in decoyed),
        "roc: limit on chance; share passed of true cases, wrong places, decoys": roc,
    }


if __name__ == "__main__":
    main()
