# SPDX-License-Identifier: Apache-2.0
"""What each loss and each preparation of the radiance field is worth: one switched at a time.

    python benchmarks/nerf_ablation.py SITE RUN [--iterations 400] [--results FILE]

SITE is a simulated site, RUN the folder of a finished `skymoor run` of it, whose depth maps are used. The surface of
the nadir view and of two obliques is compared with the simulated world. Holes in the depth maps are where the ranking
by monocular depth can help, so it is also tried on depth maps that lost half of what they had on roofs; its depths are
the true ones with a random scale and bend per photo.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parent))
from scene_models import _Cameras, airborne_scene, compare

from skymoor.model import NerfBuilder, nadir_view, oblique_views
from skymoor.model.nerf import LossWeights, Sizes, UncertaintyOptions
from skymoor.model.nerf.prior import Votes
from skymoor.simulate.light.photo import true_depth, true_labels
from skymoor.simulate.mesh import Label
from skymoor.simulate.site import Site, true_enu_from_sfm
from skymoor.store import read_stage
from skymoor.types import Array32, DepthMap

COARSE = 2.0  # rendered pixels per pixel of the photos: a quarter of the rays says as much


@dataclass(frozen=True)
class Case:
    """One row of the table."""

    name: str
    builder: NerfBuilder
    blind_roofs: bool = False
    ranked: bool = False
    prior: bool = True


def cases(iterations: int) -> Iterator[Case]:
    sizes = Sizes(iterations=iterations, passes=100.0)
    full = NerfBuilder(small=sizes, threads=2, uncertainty=UncertaintyOptions(rays=0))
    yield Case("all", full)
    for name in ("photometric", "depth", "line_of_sight", "distortion", "opacity"):
        yield Case(f"no {name}", replace(full, losses=replace(LossWeights(), **{name: 0.0})))
    silent = replace(LossWeights(), depth=0.0, line_of_sight=0.0, distortion=0.0, opacity=0.0)
    yield Case("photometric only", replace(full, losses=silent))
    yield Case("no prior", full, prior=False)
    yield Case("no prior, photometric only", replace(full, losses=silent), prior=False)
    yield Case("prior only, no training", replace(full, small=replace(sizes, iterations=1, table_rate=1e-12)))
    yield Case("exact backward", replace(full, small=replace(sizes, exact_backward=True)))
    yield Case("half of the roofs unmeasured", full, blind_roofs=True)
    yield Case("the same, ranked by monocular depth", full, blind_roofs=True, ranked=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", type=Path)
    parser.add_argument("run", type=Path)
    parser.add_argument("--iterations", type=int, default=400)
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    scene = airborne_scene(options.site)
    maps: list[DepthMap] = read_stage(options.run, "airborne-0.depths")
    truth = json.loads((options.site / "truth.json").read_text())
    site = Site(options.site, None, np.zeros(3), np.eye(3))  # type: ignore[arg-type]
    enu_from_level = true_enu_from_sfm(_Cameras([m.camera for m in maps]), site.cameras.values())  # type: ignore[arg-type]
    true_maps = [true_depth(scene, m.camera.transformed(enu_from_level)) for m in maps]
    labels = [true_labels(scene, m.camera.transformed(enu_from_level)) for m in maps]
    rows = []
    for case in cases(options.iterations):
        used = blind_roofs(maps, labels) if case.blind_roofs else maps
        told: list[dict[str, float]] = []
        order = bent(true_maps) if case.ranked else None
        flat = nullcontext() if case.prior else patch("skymoor.model.nerf.build.log_density_prior", no_prior)
        with flat:
            model = case.builder(None, used, monocular=order, report=lambda found, told=told: told.append(dict(found)))  # type: ignore[arg-type,misc]
        row: dict[str, Any] = {"case": case.name, "psnr_db": told[-1]["psnr_db"] if told else None}
        obliques = oblique_views(model.surface_points, COARSE * model.pixel)
        views = {
            "nadir": nadir_view(model.surface_points, COARSE * model.pixel),
            "north": obliques[0],
            "east": obliques[2],
        }
        for name, view in views.items():
            render = model.render(view)
            error, _, label = compare(render, view, scene, enu_from_level, truth["options"]["radius_m"])
            row[name] = figures(error)
            row[f"{name}_roofs"] = figures(error[label == Label.ROOF])
        rows.append(row)
        print(json.dumps(row), flush=True)
    if options.results:
        options.results.write_text(json.dumps(rows, indent=1) + "\n")


def no_prior(votes: Votes, *_: object) -> torch.Tensor:
    """Nothing known beforehand."""
    return torch.zeros_like(votes.free)


def figures(error: Array32) -> list[float]:
    """Holes, median, mean of |error| in metres, and the share above a metre."""
    near = np.abs(error[np.isfinite(error)])
    return [float(1 - len(near) / len(error)), float(np.median(near)), float(near.mean()), float((near > 1).mean())]


def blind_roofs(maps: Sequence[DepthMap], labels: Sequence[Any]) -> list[DepthMap]:
    """Without the depths of roofs that lie east of the middle."""
    found = []
    for m, label in zip(maps, labels, strict=True):
        v, u = np.nonzero(label == Label.ROOF)
        rays = m.camera.intrinsics.rays(np.column_stack([u, v]) + 0.5)
        xyz = m.camera.cam_from_world.inverse().apply(rays * m.depth[v, u][:, None])
        east = xyz[:, 0] > 0
        depth = m.depth.copy()
        depth[v[east], u[east]] = np.nan
        found.append(replace(m, depth=depth))
    return found


def bent(depths: Sequence[Array32]) -> list[Array32]:
    """As a monocular engine would say it: another scale and another bend for each photo."""
    rng = np.random.default_rng(0)
    return [(rng.uniform(0.5, 2) * depth ** rng.uniform(0.8, 1.25)).astype(np.float32) for depth in depths]


if __name__ == "__main__":
    main()
