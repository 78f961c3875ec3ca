# SPDX-License-Identifier: Apache-2.0
"""Our radiance field beside nerfstudio's depth-nerfacto in plain PyTorch: the same photos, rays and processor time.

    python -m venv PEER && PEER/bin/pip install torch numpy scipy opencv-python-headless pyproj rasterio nerfstudio
    PYTHONPATH=src PEER/bin/python benchmarks/nerfacto_peer.py RESULT [--results FILE]

RESULT is the folder of a finished `skymoor run`; its depth maps are what both are trained on, but for every eighth
photo, on which both are judged: PSNR after the best gain per channel (exposure is a photo's own), and the distance of
the median depth from what that photo's own depth map says. Each gets the processor time that our default takes, all
preparations counted, on two threads, one after the other.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before PyTorch: waiting threads would count as work

import torch

from skymoor.model import NerfBuilder
from skymoor.model.nerf import Sizes, UncertaintyOptions
from skymoor.model.nerf.box import INNER_PER_LEVEL
from skymoor.model.nerf.render import integrate_rays
from skymoor.store import read_stage
from skymoor.types import DepthMap

HOLD_OUT = 8
RAYS = 4096
EVALUATED = 20000  # pixels per held-out photo
CHUNK = 4096


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--iterations", type=int, default=600, help="of ours, which sets the time of both")
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(2)
    maps: list[DepthMap] = read_stage(options.run, "airborne-0.depths")
    held = maps[HOLD_OUT // 2 :: HOLD_OUT]
    kept = [m for k, m in enumerate(maps) if (k - HOLD_OUT // 2) % HOLD_OUT]
    ours = train_ours(kept, held, options.iterations)
    print(json.dumps(ours), flush=True)
    peer = train_nerfacto(kept, held, ours["cpu_s"])
    print(json.dumps(peer), flush=True)
    ratio = {
        "psnr_gain_db": ours["psnr_db"] - peer["psnr_db"],
        "depth_error_ratio": peer["depth_error_percent"] / ours["depth_error_percent"],
        "rays_ratio": ours["rays"] / peer["rays"],
    }
    print(json.dumps(ratio))
    if options.results:
        rows = {"photos": len(maps), "ours": ours, "nerfacto": peer, "ratio": ratio}
        options.results.write_text(json.dumps(rows, indent=1) + "\n")


def train_ours(kept: list[DepthMap], held: list[DepthMap], iterations: int) -> dict[str, float]:
    started, wall = time.process_time(), time.monotonic()
    steps = [0.0]
    sizes = Sizes(iterations=iterations)
    builder = NerfBuilder(small=sizes, threads=2, uncertainty=UncertaintyOptions(rays=0))
    model = builder(None, kept, report=lambda found: steps.append(found["step"]))  # type: ignore[arg-type]
    cpu, wall = time.process_time() - started, time.monotonic() - wall
    field, box = model.field, model.field.box

    @torch.no_grad()
    def see(origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        start = torch.tensor(box.inner_from_level(origin), dtype=torch.float32)
        depths, colours = [], []
        for part in torch.split(torch.tensor(rays, dtype=torch.float32), CHUNK):
            near, far = box.span(start.expand_as(part), part)
            far = torch.maximum(far, near + 1e-3)
            t, rgb, _, _ = integrate_rays(field, model.proposal, start.expand_as(part), part, near, far, None)
            depths.append(t.numpy() / INNER_PER_LEVEL)
            colours.append(rgb.numpy())
        return np.concatenate(depths), np.concatenate(colours)

    return {"cpu_s": cpu, "wall_s": wall, "rays": steps[-1] * builder.sizes.rays, **judge(see, held)}


def train_nerfacto(kept: list[DepthMap], held: list[DepthMap], seconds: float) -> dict[str, float]:
    from nerfstudio.cameras.camera_optimizers import CameraOptimizerConfig
    from nerfstudio.cameras.rays import RayBundle
    from nerfstudio.data.scene_box import SceneBox
    from nerfstudio.models.depth_nerfacto import DepthNerfactoModelConfig

    started, wall = time.process_time(), time.monotonic()
    torch.manual_seed(0)
    centres = np.array([m.camera.centre for m in kept])
    middle = np.append(centres[:, :2].mean(axis=0), 0.0)
    scale = 1 / np.abs(centres - middle).max()  # as nerfstudio's parsers: cameras fill the cube from -1 to 1
    sigma = scale * float(np.median([np.nanmedian(m.sigma) for m in kept]))
    config = DepthNerfactoModelConfig(
        implementation="torch", depth_sigma=sigma, camera_optimizer=CameraOptimizerConfig(mode="off")
    )
    box = SceneBox(aabb=torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]))
    # A metric that is not used here would load weights.
    with patch("torchmetrics.image.lpip.LearnedPerceptualImagePatchSimilarity", lambda **_: torch.nn.Identity()):
        model: Any = config.setup(scene_box=box, num_train_data=len(kept))
    model.train()
    groups = model.get_param_groups()
    optimiser = torch.optim.Adam(
        [p for name in ("proposal_networks", "fields") for p in groups[name]], lr=1e-2, eps=1e-15
    )
    steps_like = 30000  # nerfacto's own schedule
    decay = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda k: 0.01 ** min(k / steps_like, 1.0))
    anneal, after = model.get_training_callbacks(None)
    colour, depth = (
        np.stack([m.rgb for m in kept]),
        np.stack([np.nan_to_num(m.depth, nan=0.0) * scale for m in kept]),
    )
    rng, step = np.random.default_rng(0), 0
    n, h, w = depth.shape

    def bundle(origin: np.ndarray, rays: np.ndarray, image: np.ndarray) -> Any:
        direction = torch.tensor(rays, dtype=torch.float32)
        norm = direction.norm(dim=-1, keepdim=True)
        area = torch.full_like(norm, (1 / kept[0].camera.intrinsics.fx) ** 2)
        return RayBundle(
            origins=torch.tensor((origin - middle) * scale, dtype=torch.float32).expand_as(direction).contiguous(),
            directions=direction / norm,
            pixel_area=area,
            camera_indices=torch.tensor(image[:, None]),
            metadata={"directions_norm": norm},
        )

    rotations = np.stack([m.camera.cam_from_world.rotation for m in kept])
    while time.process_time() - started < seconds:
        anneal.func(step)
        image, row, column = rng.integers(n, size=RAYS), rng.integers(h, size=RAYS), rng.integers(w, size=RAYS)
        local = kept[0].camera.intrinsics.rays(np.column_stack([column, row]) + 0.5)
        rays = np.einsum("ij,ijk->ik", local, rotations[image])
        batch = {
            "image": torch.tensor(colour[image, row, column] / 255.0, dtype=torch.float32),
            "depth_image": torch.tensor(depth[image, row, column], dtype=torch.float32)[:, None],
        }
        outputs = model(bundle(centres[image], rays, image))
        loss = sum(model.get_loss_dict(outputs, batch, model.get_metrics_dict(outputs, batch)).values())
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        decay.step()
        after.func(step)
        step += 1
    cpu, wall = time.process_time() - started, time.monotonic() - wall
    model.eval()

    @torch.no_grad()
    def see(origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        depths, colours = [], []
        for part in np.array_split(rays, max(1, len(rays) // CHUNK)):
            asked = bundle(np.broadcast_to(origin, part.shape), part, np.zeros(len(part), int))
            found = model(asked)
            depths.append((found["depth"] / asked.metadata["directions_norm"])[:, 0].numpy() / scale)
            colours.append(found["rgb"].numpy())
        return np.concatenate(depths), np.concatenate(colours)

    return {"cpu_s": cpu, "wall_s": wall, "rays": step * RAYS, **judge(see, held)}


def judge(see: Any, held: list[DepthMap]) -> dict[str, float]:
    """PSNR and the share of depth by which the median depth is off, over pixels of photos that were held out.

    `see` gives z-depth in level units and colours of rays with z = 1 in the camera.
    """
    squares, errors = [], []
    for m in held:
        i = m.camera.intrinsics
        rng = np.random.default_rng(0)
        row, column = rng.integers(i.height, size=EVALUATED), rng.integers(i.width, size=EVALUATED)
        local = i.rays(np.column_stack([column, row]) + 0.5)
        found, rgb = see(m.camera.centre, local @ m.camera.cam_from_world.rotation)
        truth = m.rgb[row, column] / 255.0
        measured = m.depth[row, column]
        use = np.isfinite(measured)
        gain = (rgb * truth)[use].sum(axis=0) / (rgb**2)[use].sum(axis=0)
        squares.append((((rgb * gain) - truth)[use] ** 2).mean())
        errors.append(np.abs(found[use] / measured[use] - 1))
    error = np.concatenate(errors)
    return {
        "psnr_db": float(-10 * np.log10(np.mean(squares))),
        "depth_error_percent": 100 * float(np.median(error)),
        "depth_within_1_percent": float((error < 0.01).mean()),
    }


if __name__ == "__main__":
    main()
