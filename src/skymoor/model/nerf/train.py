# SPDX-License-Identifier: Apache-2.0
"""Training within a budget of time and steps, resumable from a checkpoint."""

from __future__ import annotations

import hashlib
import io
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from skymoor.errors import DegenerateGeometry
from skymoor.model.nerf import losses
from skymoor.model.nerf.field import Field
from skymoor.model.nerf.options import LossWeights
from skymoor.model.nerf.photos import Pixels, Rays
from skymoor.model.nerf.sampling import Proposal, composite, midpoints, sample_measured, sample_proposal
from skymoor.types import Progress

Report = Callable[[Mapping[str, float]], None]

HALF_SIZE_UNTIL = 0.3  # of the training: averaged pixels are more informative at first
RANKING_FROM = 0.25
WARM_UP_STEPS = 50
DECAY = 0.1
MEASURED_SHARE = 0.6  # of the samples of a ray with a measured depth
REPORT_STEPS = 20
DIGEST_BYTES = hashlib.sha256().digest_size  # in front of a checkpoint
BAD_STEPS = 20  # consecutive, with a loss that is not finite


@dataclass(frozen=True, eq=False)
class Schedule:
    """Budget and checkpoint of a training.

    Attributes:
        budget_s: seconds on the clock, 0 for no limit. A training that time ends is not reproducible bit by bit.
        checkpoint: file that is written every `checkpoint_s` seconds and read if it is there; None for none.
        key: of the checkpoint's options and data; a file with another key is ignored.
    """

    budget_s: float = 0.0
    checkpoint: Path | None = None
    checkpoint_s: float = 30.0
    key: str = ""


def _line(values: Mapping[str, float]) -> str:
    """Progress as text. Inner units are hundredths of the flying height."""
    return (
        f"step {values['step']}, PSNR {values['psnr_db']:.1f} dB, "
        f"depth error {values['depth_error']:.3f} % of the height, "
        f"{values['left_s']:.0f} s left"
    )


class Trainer:
    """Training of a field: `run` the whole, `step` one step."""

    def __init__(
        self,
        field: Field,
        proposal: Proposal,
        pixels: tuple[Pixels, Pixels],
        log_gains: Tensor,
        weights: LossWeights,
        seed: int,
        *,
        pixel_inner: float,
    ) -> None:
        """`pixels` are the photos at half size and in full, `log_gains` (n, 3) their exposures; `pixel_inner` is the
        size of a photo's pixel on the ground."""
        self.field, self.proposal, self.pixels = field, proposal, pixels
        self.weights, self.sizes = weights, field.sizes
        self._gains = log_gains.exp()
        self._sigma_floor = weights.depth_sigma_px * pixel_inner
        self._generator = torch.Generator().manual_seed(seed)
        self.steps, self.seconds, self._bad = 0, 0.0, 0
        table = [p for name, p in field.named_parameters() if name.startswith("grid")]
        others = [p for name, p in field.named_parameters() if not name.startswith("grid")]
        groups = [{"params": table, "lr": 0.0}, {"params": others, "lr": 0.0}]
        self.iterations = min(self.sizes.iterations, math.ceil(self.sizes.passes * len(pixels[1]) / self.sizes.rays))
        self._rates = (self.sizes.table_rate, self.sizes.mlp_rate)
        self._optimiser = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)

    def run(self, schedule: Schedule, progress: Progress, report: Report | None = None) -> None:
        """Train until the steps or the seconds are used up.

        Raises `DegenerateGeometry` when the loss is no longer finite.
        """
        self._resume(schedule)
        begun, saved = time.monotonic() - self.seconds, time.monotonic()
        while self.steps < self.iterations:
            self.seconds = time.monotonic() - begun
            if schedule.budget_s and self.seconds >= schedule.budget_s:
                break
            done = max(self.steps / self.iterations, self.seconds / (schedule.budget_s or math.inf))
            metrics = self.step(done)
            if self.steps % REPORT_STEPS == 0:
                left = self.seconds * (1 / max(done, 1e-3) - 1)
                values = {"step": self.steps, "left_s": left, **{k: float(v) for k, v in metrics.items()}}
                progress(round(1000 * done), 1000, _line(values))
                if report is not None:
                    report(values)
            if schedule.checkpoint is not None and time.monotonic() - saved > schedule.checkpoint_s:
                self.save(schedule.checkpoint, schedule.key)
                saved = time.monotonic()
        progress(1000, 1000)

    def step(self, done: float) -> dict[str, Tensor]:
        """One step, at the share `done` of the training; returns psnr (dB) and depth error (inner units)."""
        for group, rate in zip(self._optimiser.param_groups, self._rates, strict=True):
            group["lr"] = rate * min(1.0, (self.steps + 1) / WARM_UP_STEPS) * DECAY ** max(0.0, (done - 0.2) / 0.8)
        pixels = self.pixels[0 if done < HALF_SIZE_UNTIL else 1]
        rays = pixels.rays(pixels.draw(self.sizes.rays, self._generator))
        self._optimiser.zero_grad(set_to_none=False)
        loss, metrics = self._loss(rays, ranked=done >= RANKING_FROM)
        self.steps += 1
        if not torch.isfinite(loss):
            self._bad += 1
            if self._bad >= BAD_STEPS:
                raise DegenerateGeometry("the training of the radiance field diverged: lower its learning rates")
            return metrics
        self._bad = 0
        loss.backward()  # type: ignore[no-untyped-call]
        self._optimiser.step()
        return metrics

    def _loss(self, rays: Rays, *, ranked: bool) -> tuple[Tensor, dict[str, Tensor]]:
        valid, weights = rays.valid, self.weights
        near, far = rays.near, torch.where(valid, rays.far, rays.near + 1.0)
        sigma = rays.sigma.clamp(min=self._sigma_floor)
        depth = torch.where(valid & (rays.depth > near) & (rays.depth < far), rays.depth, torch.nan)
        with torch.no_grad():
            t = self._samples(rays, near, far, depth, sigma)
            unit = self.field.box.unit_from_inner(
                (rays.origin[:, None] + t[..., None] * rays.direction[:, None]).view(-1, 3)
            )
        draws = self._uniform(len(unit), 3).to(unit.device)
        count = t.shape[1]
        direction, image = rays.direction.repeat_interleave(count, 0), rays.image.repeat_interleave(count)
        density, colour = self.field(unit, direction, image, draws)
        self.proposal.update(unit, density.detach())
        composited = composite(density.view(t.shape), t, far)
        rgb = (composited.weights[..., None] * midpoints(colour.view(*t.shape, 3))).sum(dim=1) * self.field.gains(
            rays.image
        )
        target = rays.rgb / self._gains[rays.image]
        # The remaining transmittance gets the mean colour, so that it does not influence the field.
        rgb = rgb + (1 - composited.opacity[:, None]) * target.mean(dim=0)
        error = torch.where(valid[:, None], rgb - target, 0.0)
        terms = {
            "photometric": losses.photometric_loss(error, torch.zeros_like(error)),
            "depth": losses.depth_loss(composited.weights, composited.edges, depth, sigma),
            "line_of_sight": losses.line_of_sight_loss(composited.weights, composited.centres, depth, sigma),
            "distortion": losses.distortion_loss(
                composited.weights * valid[:, None], composited.centres, composited.edges
            ),
            "opacity": losses.opacity_loss(composited.opacity, self._must_end(rays)),
        }
        if ranked and self.pixels[0].relative is not None:
            terms["ranking"] = self._ranking(composited.mean, rays, depth)
        total = torch.stack([getattr(weights, name) * term for name, term in terms.items() if getattr(weights, name)])
        gap = (composited.median - depth).abs().detach()
        psnr = -10 * torch.log10((error.detach()[valid] ** 2).mean())
        loss = total.sum()
        return loss, {"psnr_db": psnr, "depth_error": gap[torch.isfinite(gap)].nanmedian(), "loss": loss.detach()}

    def _samples(self, rays: Rays, near: Tensor, far: Tensor, depth: Tensor, sigma: Tensor) -> Tensor:
        sizes, n = self.sizes, len(near)
        jitter = self._uniform(n, sizes.samples).to(near.device)
        normal = torch.randn(n, round(MEASURED_SHARE * sizes.samples), generator=self._generator).to(near.device)
        weights = self.proposal.weights(rays.origin, rays.direction, near, far, sizes.bins)
        t = sample_proposal(weights, near, far, sizes.samples, jitter)
        return sample_measured(t, depth, sigma, normal)

    def _must_end(self, rays: Rays) -> Tensor:
        """Rays that leave the slab through the floor of the site."""
        leave = rays.origin + rays.far[:, None] * rays.direction
        return rays.valid & (leave[:, :2].abs().amax(dim=-1) < self.field.box.half)

    def _ranking(self, mean: Tensor, rays: Rays, depth: Tensor) -> Tensor:
        pairs = [x.view(-1, 2) for x in (mean, rays.relative, depth, rays.valid)]
        counts = pairs[3].all(dim=1) & ~torch.isfinite(pairs[2]).all(dim=1)
        return losses.ranking_loss(pairs[0], pairs[1], counts, margin=1e-4 * 2 * self.field.box.half)

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(shape, generator=self._generator)

    def save(self, path: Path, key: str = "") -> None:
        """Write the state from which a later `run` resumes without difference."""
        state: dict[str, Any] = {
            "key": key,
            "field": self.field.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "proposal": self.proposal.density,
            "generator": self._generator.get_state(),
            "steps": self.steps,
            "seconds": self.seconds,
        }
        partial = path.with_name(path.name + ".part")
        try:
            content = io.BytesIO()
            torch.save(state, content)
            with partial.open("wb") as file:
                file.write(hashlib.sha256(content.getbuffer()).digest())
                file.write(content.getbuffer())
            partial.replace(path)
        except (OSError, RuntimeError):
            # Without disk space there is no checkpoint; the training continues.
            partial.unlink(missing_ok=True)

    def _resume(self, schedule: Schedule) -> None:
        path = schedule.checkpoint
        if path is None or not path.exists():
            return
        try:
            content = path.read_bytes()
            # PyTorch does not detect damaged values.
            if hashlib.sha256(content[DIGEST_BYTES:]).digest() != content[:DIGEST_BYTES]:
                return  # truncated or damaged: start again
            device = self.proposal.density.device
            state = torch.load(io.BytesIO(content[DIGEST_BYTES:]), map_location=device, weights_only=True)
        except (OSError, RuntimeError, EOFError, ValueError):
            return
        if state.get("key") != schedule.key:
            return
        self.field.load_state_dict(state["field"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.proposal.density.copy_(state["proposal"])
        self._generator.set_state(state["generator"].cpu())
        self.steps, self.seconds = int(state["steps"]), float(state["seconds"])
