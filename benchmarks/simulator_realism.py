# SPDX-License-Identifier: Apache-2.0
"""How like real ones simulated sites are: figures of site folders and of finished runs, beside those of real data.

    python benchmarks/simulator_realism.py FOLDER [FOLDER ...] [--results rows.json]

FOLDER is a simulated site (with truth_depth/ where it was written with --depths) or what `skymoor run` has written.
"""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skymoor.store import read_stage
from skymoor.types import Camera, Component, DepthMap

Array = NDArray[Any]

STEEP_DEG = 20.0  # the surface's normal is nearer to horizontal
SMOOTH = 0.002  # second difference of depth, as a share of it, up to which three pixels lie on one surface
REAL = {
    "tilt_deg": "2, 9, 20",
    "steep_percent": "0.07 to 0.27 (easy simulated sites at 34 to 37 degrees have 22 and 43 walls)",
    "ground_depth_percent": "3 to 17 (easy simulated: 35)",
    "components": "17, 15, 15, 8, 5, 5, 5 of 96",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--results", type=Path, help="a JSON file for the rows")
    options = parser.parse_args()
    rows = [site_row(f) if (f / "truth_cameras.csv").exists() else run_row(f) for f in options.folders]
    for row in [{"folder": "real", **REAL}, *rows]:
        print(json.dumps(row), flush=True)
    if options.results:
        options.results.write_text(json.dumps(rows, indent=1) + "\n")


def site_row(folder: Path) -> dict[str, Any]:
    """A simulated site: tilts and heights of its true cameras, pieces of its walks, and what has a surface at all."""
    with (folder / "truth_cameras.csv").open(encoding="utf-8", newline="") as file:
        cameras = list(csv.DictReader(file))
    truth = json.loads((folder / "truth.json").read_text())
    axes_up = [axis_up(camera) for camera in cameras if camera["set"] == "airborne"]
    depths = sorted((folder / "truth_depth" / "ground").glob("*.npz"))
    found = {
        "folder": str(folder),
        "tilt_deg": round(float(np.degrees(np.arccos(-np.median(axes_up)))), 1) if axes_up else None,
        "carriers": {letter: group["kind"] for letter, group in truth.get("groups", {}).items()},
        "widths": sorted({int(camera["width"]) for camera in cameras if camera["set"] == "ground"}),
        "pieces": pieces(folder / "truth_photos.csv"),
    }
    if depths:
        surface = [float(np.isfinite(np.load(path)["depth"]).mean()) for path in depths]
        found["ground_surface_percent"] = round(100 * float(np.mean(surface)), 1)
    return found


def axis_up(camera: dict[str, str]) -> float:
    """Component upwards of a camera's optical axis, from its quaternion (camera from ENU)."""
    x, y = float(camera["qx"]), float(camera["qy"])
    return 1.0 - 2.0 * (x * x + y * y)


def pieces(table: Path) -> dict[str, list[int]]:
    """Photos of the pieces of each walk, the longest first; empty for easy sites."""
    if not table.exists():
        return {}
    with table.open(encoding="utf-8", newline="") as file:
        rows = [(Path(row["image"]).name[0], int(row["piece"])) for row in csv.DictReader(file)]
    sizes: dict[str, list[int]] = {}
    for group, piece in dict.fromkeys(rows):
        sizes.setdefault(group, []).append(rows.count((group, piece)))
    return {group: sorted(found, reverse=True) for group, found in sorted(sizes.items())}


def run_row(run: Path) -> dict[str, Any]:
    """A finished run, simulated or real: what its depth maps show, and the sizes of its components."""
    summary = json.loads((run / "summary.json").read_text())
    maps: list[DepthMap] = read_stage(run, "airborne-0.depths")
    found = {
        "folder": str(run),
        "tilt_deg": round(float(np.median([tilt_deg(m.camera) for m in maps])), 1),
        "steep_percent": round(100 * float(np.mean([steep_share(m) for m in maps])), 3),
    }
    for name in (s["set"] for s in summary["sets"] if s["set"].startswith("ground")):
        components: list[Component] = read_stage(run, f"{name}.reconstruct")
        found[f"{name}_components"] = [len(component.cameras) for component in components]
        shares = [float(np.isfinite(m.depth).mean()) for m in ground_maps(run, name, len(components))]
        if shares:
            quartiles = np.percentile(shares, (25, 50, 75))
            found[f"{name}_depth_percent"] = [round(100 * float(share), 1) for share in quartiles]
    return found


def ground_maps(run: Path, name: str, count: int) -> list[DepthMap]:
    """The depth maps of all components of a set of ground photos that got any."""
    maps: list[DepthMap] = []
    for number in range(count):
        try:
            maps += read_stage(run, f"{name}-{number}.depths")
        except FileNotFoundError:
            continue
    return maps


def tilt_deg(camera: Camera) -> float:
    """Angle between a levelled camera's optical axis and straight down."""
    return float(np.degrees(np.arccos(np.clip(-camera.cam_from_world.rotation[2, 2], -1, 1))))


def steep_share(found: DepthMap) -> float:
    """Share of a levelled depth map's pixels with depth in which the surface is nearly upright.

    The step from a roof to the ground is not a surface: depths of three pixels in a row must lie on a line.
    """
    i, depth = found.camera.intrinsics, found.depth.astype(np.float64)
    u, v = np.meshgrid(np.arange(i.width) + 0.5, np.arange(i.height) + 0.5)
    rays = i.rays(np.column_stack([u.ravel(), v.ravel()])).reshape(i.height, i.width, 3)
    points = (rays * depth[..., None]) @ found.camera.cam_from_world.rotation
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    normal = np.cross(across, down)
    inner = depth[1:-1, 1:-1]
    bend = np.maximum(
        np.abs(depth[1:-1, 2:] + depth[1:-1, :-2] - 2 * inner), np.abs(depth[2:, 1:-1] + depth[:-2, 1:-1] - 2 * inner)
    )
    with np.errstate(invalid="ignore"):
        upright = np.abs(normal[..., 2]) < np.sin(np.radians(STEEP_DEG)) * np.linalg.norm(normal, axis=-1)
        smooth = bend < SMOOTH * inner
    return float((upright & smooth).sum() / max(np.isfinite(depth).sum(), 1))


if __name__ == "__main__":
    main()
