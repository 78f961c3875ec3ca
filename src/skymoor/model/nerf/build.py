# SPDX-License-Identifier: Apache-2.0
"""Building a radiance field from depth maps: prior, exposure, training, uncertainty."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from skymoor.engines.libraries import torch_device
from skymoor.errors import DegenerateGeometry
from skymoor.model.nerf._torch import torch_threads
from skymoor.model.nerf.box import INNER_PER_LEVEL, Box, covered_points, make_box
from skymoor.model.nerf.exposure import exposure_log_gains
from skymoor.model.nerf.field import Field
from skymoor.model.nerf.model import NerfModel
from skymoor.model.nerf.options import NerfOptions
from skymoor.model.nerf.photos import make_pixels
from skymoor.model.nerf.prior import BASE_LOG_DENSITY, cast_votes, grid_shape, log_density_prior
from skymoor.model.nerf.sampling import Proposal
from skymoor.model.nerf.train import Report, Schedule, Trainer
from skymoor.model.nerf.uncertainty import deformation_sigma
from skymoor.types import Array, Array32, DepthMap, Progress, no_progress

SPLAT_POINTS = 1_500_000
GAIN_POINTS = 400_000
GAIN_CELL_PX = 4.0


def build_model(
    builder: NerfOptions,
    maps: Sequence[DepthMap],
    progress: Progress,
    monocular: Sequence[Array32 | None] | None,
    report: Report | None,
    checkpoint: Path | None,
) -> NerfModel:
    """See `NerfBuilder`."""
    device = torch.device(torch_device(builder.device))
    with torch_threads(builder.threads):
        return _build(builder, maps, progress, monocular, report, checkpoint, device)


def _build(
    builder: NerfOptions,
    maps: Sequence[DepthMap],
    progress: Progress,
    monocular: Sequence[Array32 | None] | None,
    report: Report | None,
    checkpoint: Path | None,
    device: torch.device,
) -> NerfModel:
    max_sigma_ratio = builder.prior.max_sigma_ratio
    covered = _covered(maps, max_sigma_ratio)
    box = make_box(covered)
    pixel = float(np.median([np.nanmedian(m.depth) / m.camera.intrinsics.fx for m in maps]))
    image, xyz, rgb = _coloured_points(maps, box, max_sigma_ratio)
    log_gains = _log_gains(image, xyz, rgb, len(maps), GAIN_CELL_PX * pixel * INNER_PER_LEVEL)
    field, proposal = _untrained(builder, maps, box, pixel * INNER_PER_LEVEL, device)
    field.splat(
        box.unit_from_inner(torch.from_numpy(xyz).to(device)),
        torch.from_numpy((rgb / 255 / np.exp(log_gains[image])).astype(np.float32)).to(device),
    )
    half, full = (
        make_pixels(maps, box, max_sigma_ratio=max_sigma_ratio, monocular=monocular, halve=halve, device=device)
        for halve in (True, False)
    )
    gains = torch.tensor(log_gains, dtype=torch.float32, device=device)
    pixel_inner = pixel * INNER_PER_LEVEL
    trainer = Trainer(field, proposal, (half, full), gains, builder.losses, builder.seed, pixel_inner=pixel_inner)
    trainer.run(Schedule(builder.budget_s, checkpoint, key=_key(builder, maps)), progress, _in_level(report))
    deformation = None
    if builder.uncertainty.rays:
        deformation = deformation_sigma(
            field, proposal, full, builder.uncertainty, pixel_inner=pixel_inner, seed=builder.seed, progress=no_progress
        )
    if checkpoint is not None:
        checkpoint.unlink(missing_ok=True)
    return NerfModel(
        field=field.eval(),
        proposal=proposal,
        maps=tuple(_exposure_corrected(m, gain) for m, gain in zip(maps, log_gains, strict=True)),
        surface_points=_covered(maps, max_sigma_ratio, min_maps=2),
        pixel=pixel,
        blend=builder.blend,
        uncertainty=builder.uncertainty,
        deformation=deformation,
        texture=builder.colours,
        device=builder.device,
        threads=builder.threads,
    )


def _covered(maps: Sequence[DepthMap], max_sigma_ratio: float, min_maps: int = 3) -> Array:
    """Points measured by at least `min_maps` maps, or by two where there are too few."""
    if len(maps) < 2:
        raise DegenerateGeometry("a radiance field needs the depth maps of at least two photos")
    try:
        return covered_points(maps, max_sigma_ratio, min_maps=min_maps)
    except DegenerateGeometry:
        return covered_points(maps, max_sigma_ratio, min_maps=2)


def _untrained(
    builder: NerfOptions, maps: Sequence[DepthMap], box: Box, pixel_inner: float, device: torch.device
) -> tuple[Field, Proposal]:
    shape = grid_shape(box, pixel_inner, builder.prior)
    votes = cast_votes(maps, box, shape, builder.prior, device, no_progress)
    prior = log_density_prior(votes, box.inner_per_unit / shape[2], builder.prior)
    generator = torch.Generator().manual_seed(builder.seed)
    field = Field(builder.sizes, box, pixel_inner, prior, len(maps), generator).to(device)
    if builder.compile:
        field.grid.compile_look_up()
    return field, Proposal(box, (prior + BASE_LOG_DENSITY).exp())


def _coloured_points(
    maps: Sequence[DepthMap], box: Box, max_sigma_ratio: float
) -> tuple[np.ndarray, Array32, np.ndarray]:
    """Photo (n,), inner position (n, 3) and colour (n, 3) of measured pixels of all photos."""
    total = sum(m.depth.size for m in maps)
    step = max(1, round(np.sqrt(total / SPLAT_POINTS)))
    parts = [m.points(max_sigma_ratio=max_sigma_ratio, step=step) for m in maps]
    image = np.repeat(np.arange(len(maps)), [len(points) for points, _ in parts])
    xyz = np.concatenate([box.inner_from_level(points.astype(np.float64)) for points, _ in parts]).astype(np.float32)
    return image, xyz, np.concatenate([colours for _, colours in parts])


def _log_gains(image: np.ndarray, xyz: Array32, rgb: np.ndarray, n_images: int, cell_size: float) -> Array:
    cells = np.floor(xyz / cell_size).astype(np.int64)
    cells -= cells.min(axis=0)
    cell = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    # Black and saturated pixels carry no information on exposure.
    usable = np.flatnonzero(((rgb > 12) & (rgb < 243)).all(axis=1))
    usable = usable[:: max(1, len(usable) // GAIN_POINTS)]
    return exposure_log_gains(image[usable], cell[usable], np.log(rgb[usable] / 255), n_images)


def _exposure_corrected(depth_map: DepthMap, log_gain: Array) -> DepthMap:
    """The photo corrected to the common exposure."""
    rgb = np.clip(depth_map.rgb / np.exp(log_gain) + 0.5, 0, 255).astype(np.uint8)
    return replace(depth_map, rgb=rgb)


def _in_level(report: Report | None) -> Report | None:
    if report is None:
        return None

    def report_in_level(values: Mapping[str, float]) -> None:
        report({**values, "depth_error": values["depth_error"] / INNER_PER_LEVEL})

    return report_in_level


def _key(builder: NerfOptions, maps: Sequence[DepthMap]) -> str:
    """Hash of all options except the time budget, and of the depth maps: identifies a checkpoint."""
    digest = hashlib.sha256(repr(replace(builder, budget_s=0.0)).encode())
    for depth_map in maps:
        digest.update(np.ascontiguousarray(depth_map.depth[::16, ::16]).tobytes())
        digest.update(np.ascontiguousarray(depth_map.rgb[::16, ::16]).tobytes())
    return digest.hexdigest()
