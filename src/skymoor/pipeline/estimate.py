# SPDX-License-Identifier: Apache-2.0
"""What a run will do, and about how long that takes, before it is done.

Seconds are those of two cores without a GPU, fitted to whole runs (docs/benchmarks.md); they are right to a factor of
two where the default engines do the work. Learned ones are counted by what a pair or photo took (docs/engines.md).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skymoor.pipeline.job import Job
from skymoor.pipeline.options import Options

Size = tuple[int, int]

PAIR_S = {"sift": 0.07, "aliked": 0.5, "dedode_roma": 250.0, "colmap_aliked": 0.5}
FEATURE_S = {"sift": 0.3, "aliked": 2.0, "dedode_roma": 6.0, "colmap_aliked": 1.0}
DENSE_S = {"structural": 1.6, "roma": 122.0, "tiny_roma": 0.6, "romav2": 200.0, "loftr": 5.0, "aliked": 2.2}
PARTNERS = 12  # of each photo in sets that are too large for all pairs
LIBRARIES_MIB = 450
WHOLE = (0.0, 1.0)
AIRBORNE = {
    **{name: (name, *WHOLE) for name in ("reference", "photos", "search", "decoys", "products")},
    "reconstruction": ("reconstruct", *WHOLE),
    "dense depth": ("depths", *WHOLE),
    "depths of single photos": ("model", 0.0, 0.3),
    "model": ("model", 0.3, 0.6),
    "nadir view": ("model", 0.6, 1.0),
    "walls": ("register", 0.5, 1.0),
    "oblique views": ("register", 0.5, 1.0),
}
GROUND = {
    "photos": ("photos", *WHOLE),
    "reconstruction": ("reconstruct", *WHOLE),
    "dense depth": ("depths", *WHOLE),
    "metres of single photos": ("search", 0.0, 0.3),
    "places on the map": ("search", *WHOLE),
    "walls": ("search", 0.0, 0.4),
    "tiles": ("search", *WHOLE),
}
"""Steps by what progress calls their work, and which part of the step that is."""
TIMED = ("register", ".search")
"""Ends of the names of steps of which only a part reports progress: they are judged by their time, too."""


@dataclass(frozen=True)
class Step:
    """One step of a run: what it does, about how many seconds it takes and at most how many MiB it holds."""

    name: str
    what: str
    seconds: float
    mib: float


def estimate_run(
    airborne: Sequence[Size], ground: Sequence[Sequence[Size]], grid_px: int, options: Options
) -> list[Step]:
    """The steps of a run on photos of these sizes (width, height), with a reference of `grid_px` pixels."""
    if not airborne:
        return _without_airborne(ground, grid_px, options)
    n, match = len(airborne), options.match
    # Depth maps are on the disk; a radiance field is trained with all of them in memory.
    held = 2 * _depth_mib(airborne) if options.model.kind == "nerf" else 0.0
    dense = DENSE_S.get(match.matcher, 2.0)
    model = options.model.nerf.budget_s or 900.0 if options.model.kind == "nerf" else 0.2 * n
    scales = np.log(match.max_height_m / match.min_height_m) / np.log(10.0)
    search, searched = 25.0 * scales, LIBRARIES_MIB + held / 2 + 60 * grid_px / 2**20
    steps = [
        _reference(grid_px),
        Step("photos", f"check {n} airborne photos", *_check(airborne)),
        *_checks(ground),
        Step("reconstruct", f"{n} photos by {options.reconstruct.matcher}", *_mapping(airborne, options, "air")),
        Step("depths", f"depth maps by {options.densify.method}; what photos say of each other", 0.7 * n, 800),
        Step("model", f"{options.model.kind} and its view from above", model + 0.3 * n, held + 1000),
        Step("search", "every azimuth, scale and position in the orthophoto", search, searched),
        Step("decoys", "the same for decoys", 3 * search, searched),
        Step(
            "register",
            f"match by {match.matcher}, estimate the transform, accept or refuse",
            5 + 2 * match.candidates * dense,
            searched,
        ),
    ]
    steps += _ground(ground, options, _depth_mib(airborne))
    return [*steps, Step("products", "tables, models, figures, report", 10 + 0.1 * n, searched)]


def estimate_jobs(jobs: Sequence[Job]) -> list[Step]:
    """The steps of a run whose input is read: one job for each set of photos."""
    ground = [job.photos.sizes for job in jobs if job.name != "airborne"]
    airborne = jobs[0].photos.sizes if len(ground) < len(jobs) else ()
    return estimate_run(airborne, ground, jobs[0].reference.rgb[..., 0].size, jobs[0].options)


def step_of(name: str) -> tuple[str, float, float] | None:
    """The step that progress of this name belongs to, and where it begins and ends in that step, from 0 to 1.

    None for a name that is of no step. Such as "airborne-0: dense depth": what a component of a set goes through.
    """
    ground = re.match(r"ground\d+", name)
    work = re.split(r": |\.", name)[-1]
    step, begin, end = (AIRBORNE if ground is None else GROUND).get(work, ("", *WHOLE))
    if not step:
        return None
    return step if ground is None else f"{ground[0]}.{step}", begin, end


def _without_airborne(ground: Sequence[Sequence[Size]], grid_px: int, options: Options) -> list[Step]:
    steps = [_reference(grid_px), *_checks(ground), *_ground(ground, options)]
    return [*steps, Step("products", "tables, figures, report", 5, LIBRARIES_MIB + 60 * grid_px / 2**20)]


def _reference(grid_px: int) -> Step:
    return Step("reference", f"read orthophoto and DSM, {grid_px / 1e6:.1f} million pixels", 2 + 2e-7 * grid_px, 700)


def _checks(ground: Sequence[Sequence[Size]]) -> list[Step]:
    checked = [(f"ground{k}.photos", f"check {len(photos)} ground photos") for k, photos in enumerate(ground)]
    return [Step(name, what, *_check(photos)) for (name, what), photos in zip(checked, ground, strict=True)]


def _ground(sets: Sequence[Sequence[Size]], options: Options, airborne_mib: float = 0.0) -> list[Step]:
    """All sets are reconstructed before the first is searched, for which the airborne depth maps are in memory too."""
    ground, models, searches = options.ground, [], []
    for k, photos in enumerate(sets):
        n, name, depths = len(photos), f"ground{k}", _depth_mib(photos)
        pairs = {"walls": 0, "cascade": 10 * n, "exhaustive": 400 * n}[ground.method]
        seconds = 60 + 8 * n + pairs * 2 * DENSE_S.get(ground.matcher, 2.0)
        models += [
            Step(f"{name}.reconstruct", f"{n} photos, lenses, look-alikes", *_mapping(photos, options, "ground")),
            Step(f"{name}.depths", f"depth maps by {ground.densify}", 0.7 * n, depths + 600),
        ]
        searches.append(
            Step(f"{name}.search", f"every component by {ground.method}", seconds, airborne_mib + depths + 1200)
        )
    return [*models, *searches]


def _check(photos: Sequence[Size]) -> tuple[float, float]:
    pixels = [w * h for w, h in photos]
    return 0.02 * sum(pixels) / 1e6, LIBRARIES_MIB + 10 * max(pixels, default=0) / 2**20


def _mapping(photos: Sequence[Size], options: Options, kind: str) -> tuple[float, float]:
    matcher = (options.reconstruct if kind == "air" else options.ground.reconstruct).matcher
    n = len(photos)
    pairs = n * (n - 1) / 2 if n <= 40 else PARTNERS * n
    megapixels = float(np.mean([min(w * h, 3_000_000) / 1e6 for w, h in photos])) if n else 0.0
    feature = FEATURE_S.get(matcher, 1.0) + 0.4 * megapixels
    return n * (feature + 0.8) + pairs * PAIR_S.get(matcher, 0.1), 700 + 8 * n


def _depth_mib(photos: Sequence[Size], side_px: int = 800) -> float:
    """Of the depth maps of all photos: 12 bytes a pixel, and the photo itself."""
    pixels = sum(w * h * min(1.0, side_px / max(w, h)) ** 2 for w, h in photos)
    return 15 * pixels / 2**20
