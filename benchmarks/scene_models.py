# SPDX-License-Identifier: Apache-2.0
"""The radiance field against the fused mesh: what each costs, how well it knows where things are, and what that does
to the cameras' places.

    python benchmarks/scene_models.py --out RUNS SITE [SITE ...] [--set model.nerf.iterations=400] [--models ...]

SITE is a folder with site.toml and truth.csv. Both models are built from the same depth maps, one after the other, by
the skymoor command. For a simulated site every ray of the nadir view and of the eight obliques is also cast into the
simulated world, so that the surface is judged and not its colours: image-based colour hides wrong geometry.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skymoor.model import oblique_views
from skymoor.model.nerf.uncertainty import reliability
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.mesh import Label
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.plan import dates_of
from skymoor.simulate.site import Site, true_enu_from_sfm
from skymoor.simulate.world import World
from skymoor.store import read_stage
from skymoor.types import Camera, Render, View

Array = NDArray[Any]

NEAR_M = 0.3  # what reliability calls right
SITE_LABELS = (Label.GROUND, Label.PAVED, Label.WATER, Label.WALL, Label.ROOF)
BINS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sites", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--models", nargs="+", default=["mesh", "nerf"])
    parser.add_argument("--set", action="append", default=[], help="an option of skymoor run")
    parser.add_argument("--results", type=Path, help="a JSON file for the rows")
    options = parser.parse_args()
    rows = []
    for folder in options.sites:
        scene = airborne_scene(folder)
        for kind in options.models:
            rows.append(case(folder, kind, options.out / f"{folder.parent.name}-{folder.name}", options.set, scene))
            print(json.dumps(rows[-1]), flush=True)
    show(rows)
    if options.results:
        options.results.write_text(json.dumps(rows, indent=1) + "\n")


def airborne_scene(folder: Path) -> Scene | None:
    """The world on the day of the flight; None for a real site."""
    if not (folder / "truth.json").exists():
        return None
    options = json.loads((folder / "truth.json").read_text()).get("options")
    if options is None:
        return None
    world = World(SiteOptions(**options))
    return world.scene(dates_of(world.options).airborne)


def case(folder: Path, kind: str, out: Path, more: list[str], scene: Scene | None) -> dict[str, Any]:
    """One model of one site."""
    out.mkdir(parents=True, exist_ok=True)
    with (out / f"{kind}.log").open("a") as log:
        options = [word for text in [f"model.kind={kind}", *more] for word in ("--set", text)]
        status = skymoor(log, "run", str(folder / "site.toml"), "--out", str(out / "result"), *options)
        if status not in (0, 3) or skymoor(log, "evaluate", str(out / "result"), "--truth", str(folder / "truth.csv")):
            return {"site": str(folder), "model": kind, "status": f"exit {status}"}
    summary = json.loads((out / "result/summary.json").read_text())
    (component, *_) = summary["sets"][0]["components"]
    row = json.loads((out / "result/evaluation.json").read_text())["rows"][0]
    seconds = {stage["name"]: stage["seconds"] for stage in summary["stages"]}
    found = {
        "site": out.name,
        "model": kind,
        "status": row["status"],
        "matches": component["n_matches"],
        "inliers": component["n_inliers"],
        "score": component.get("diagnostics", {}).get("score"),
        "mean_absolute_m": row["mean_absolute_m"],
        "mean_relative_m": row["mean_relative_m"],
        "own_m": own_error(folder, out / "result", row),
        "build_s": seconds["airborne-0.model"],
        "nadir_s": seconds["airborne-0.nadir"],
    }
    if scene is not None:
        found |= surface_errors(folder, out / "result", scene)
    return found


def own_error(folder: Path, result: Path, row: dict[str, Any]) -> float | None:
    """The mean error of the cameras without the bias that a simulated reference was given."""
    if row["status"] != "REGISTERED" or not (folder / "truth.json").exists():
        return None
    truth = json.loads((folder / "truth.json").read_text())
    if "bias_m" not in truth or "options" not in truth:
        return None
    sys.path.insert(0, str(Path(__file__).parent))
    from paper_tables import split

    return split(folder, result, row, truth)["own_mean_absolute_m"]


def surface_errors(folder: Path, run: Path, scene: Scene) -> dict[str, Any]:
    """Distances between rendered and true surfaces along the rays, in metres, and whether the confidence knows."""
    model = read_stage(run, "airborne-0.model")
    truth = json.loads((folder / "truth.json").read_text())
    site = Site(folder, None, np.array(truth["bias_m"]), np.array(truth["covariance"]))  # type: ignore[arg-type]
    enu_from_level = true_enu_from_sfm(_Cameras([m.camera for m in model.maps]), site.cameras.values())  # type: ignore[arg-type]
    nadir, views = read_stage(run, "airborne-0.nadir"), oblique_views(model.surface_points, model.pixel)
    found: dict[str, Any] = {}
    parts = {"nadir": [compare(nadir, nadir.view, scene, enu_from_level, truth["options"]["radius_m"])]}
    started = time.monotonic()
    renders = [model.render(view, progress=lambda *_: None) for view in views]
    found["obliques_s"], found["oblique_px"] = time.monotonic() - started, max(max(view.shape) for view in views)
    pairs = zip(renders, views, strict=True)
    parts["oblique"] = [compare(r, v, scene, enu_from_level, truth["options"]["radius_m"]) for r, v in pairs]
    for name, several in parts.items():
        error, confidence, label = (np.concatenate(items) for items in zip(*several, strict=True))
        near = np.abs(error[np.isfinite(error)])
        sure = np.isfinite(error) & (confidence > 0.5)
        mean, share, counts = reliability(confidence, error, NEAR_M, bins=BINS)
        roof = label == Label.ROOF
        on_roof = reliability(confidence[roof], error[roof], NEAR_M, bins=BINS)
        found[name] = {
            "holes": float(1 - np.isfinite(error).mean()),
            "median_m": float(np.median(near)),
            "mean_m": float(near.mean()),
            "over_1m": float((near > 1).mean()),
            "sure": float(sure.mean()),
            "sure_median_m": float(np.median(np.abs(error[sure]))),
            "sure_over_1m": float((np.abs(error[sure]) > 1).mean()),
            "wall_median_m": median(np.abs(error[label == Label.WALL])),
            "wall_holes": float(1 - np.isfinite(error[label == Label.WALL]).mean()),
            "reliability": [[float(x) for x in row] for row in zip(mean, share, counts, strict=True)],
            "reliability_roofs": [[float(x) for x in row] for row in zip(*on_roof, strict=True)],
        }
    return found


class _Cameras:
    """As much of a component as the true similarity needs."""

    def __init__(self, cameras: list[Camera]) -> None:
        self.cameras = cameras


def compare(
    render: Render, view: View, scene: Scene, enu_from_level: Any, radius_m: float
) -> tuple[Array, Array, Array]:
    """Error along the ray (n,), confidence (n,) and true label (n,) of the pixels whose ray ends on the site."""
    h, w = view.shape
    x, y = np.meshgrid(view.x0 + (np.arange(w) + 0.5) * view.pixel, view.y0 + (np.arange(h) + 0.5) * view.pixel)
    level = np.stack([x, y, np.full_like(x, -4.0)], axis=-1).reshape(-1, 3) @ view.view_from_level
    start = enu_from_level.apply(level)
    direction = enu_from_level.rotation @ view.view_from_level[2]
    hits = scene.cast(start.astype(np.float32), np.broadcast_to(direction.astype(np.float32), start.shape).copy())
    with np.errstate(invalid="ignore"):
        true = start + hits.distance[:, None] * direction
        on_site = np.isin(hits.label, SITE_LABELS) & (np.linalg.norm(true[:, :2], axis=1) < 0.8 * radius_m)
        found = enu_from_level.apply(render.xyz.reshape(-1, 3).astype(np.float64))
        error = (found - true) @ direction
    return error[on_site].astype(np.float32), render.confidence.reshape(-1)[on_site], hits.label[on_site]


def median(values: Array) -> float | None:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else None


def show(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        parts = [f"{row['site']:>28} {row['model']:>5} {row['status']}"]
        for name in ("matches", "inliers", "mean_absolute_m", "own_m", "mean_relative_m", "build_s", "nadir_s"):
            value = row.get(name)
            parts.append(f"{name} {value:.4g}" if value is not None else f"{name} -")
        print(" ".join(parts))
        for view in ("nadir", "oblique"):
            if view in row:
                print(" " * 12, view, " ".join(f"{k} {v:.3f}" for k, v in row[view].items() if isinstance(v, float)))


def skymoor(log: Any, *arguments: str) -> int:
    command = [str(Path(sys.executable).with_name("skymoor")), *arguments]
    return subprocess.run(command, stdout=log, stderr=subprocess.STDOUT).returncode


if __name__ == "__main__":
    main()
