# SPDX-License-Identifier: Apache-2.0
"""The radiance field: density and colour at points of the contracted slab."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from skymoor.model.nerf._torch import mlp_precision
from skymoor.model.nerf.box import Box
from skymoor.model.nerf.hashgrid import HashGrid
from skymoor.model.nerf.options import Sizes
from skymoor.model.nerf.prior import BASE_LOG_DENSITY

MAX_LOG_DENSITY = 8.0
HARMONICS = 9  # spherical harmonics up to degree 2


class Field(nn.Module):
    """density = exp(network + prior), colour = sigmoid(network + the finest level's first three features).

    Features of the finest level bypass the network, so that colours of measured points can be written into them before
    training. The networks' last layers start at zero: an untrained field is the prior with those colours.
    """

    prior: Tensor

    def __init__(
        self, sizes: Sizes, box: Box, pixel_inner: float, prior: Tensor, n_images: int, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.box, self.sizes, self.pixel_inner = box, sizes, pixel_inner
        finest = math.ceil(box.inner_per_unit / (sizes.finest_px * pixel_inner))
        self.grid = HashGrid(sizes, finest, box.height, generator)
        self.register_buffer("prior", prior[None, None])
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(torch.randint(2**31, (1,), generator=generator)))
            self.density_net = _mlp(self.grid.width, sizes.hidden, 1 + sizes.geometry, layers=1)
            inputs = sizes.geometry + sizes.appearance + (HARMONICS if sizes.view_direction else 0)
            self.colour_net = _mlp(inputs, sizes.colour_hidden, 3, layers=2)
            # Logits of colours are a hundred times larger than the other features at the start.
            first = self.density_net[0]
            assert isinstance(first, nn.Linear)
            nn.init.zeros_(first.weight[:, -sizes.features : -sizes.features + 3 or None])
        self.log_gain = nn.Parameter(torch.zeros(n_images, 3))
        self.appearance = nn.Parameter(0.01 * torch.randn(n_images, sizes.appearance, generator=generator))

    def to_state(self) -> dict[str, Any]:
        """State from which the field can be restored, on the CPU, so that it is readable without CUDA."""
        tensors = {name: tensor.detach().cpu() for name, tensor in self.state_dict().items()}
        configuration = {"sizes": self.sizes, "box": self.box, "pixel_inner": self.pixel_inner}
        return {**configuration, "n_images": len(self.log_gain), "tensors": tensors}

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> Field:
        """Restore a field from `to_state`."""
        tensors = state["tensors"]
        prior = tensors["prior"][0, 0]
        configuration = (state["sizes"], state["box"], state["pixel_inner"], prior, state["n_images"])
        field = cls(*configuration, torch.Generator().manual_seed(0))
        field.load_state_dict(tensors)
        return field

    def log_prior(self, unit: Tensor) -> Tensor:
        """The prior (n,) at unit coordinates (n, 3)."""
        position = unit * unit.new_tensor([2.0, 2.0, 2.0 / self.box.height]) - 1
        sampled = functional.grid_sample(
            self.prior, position[None, None, None], mode="bilinear", padding_mode="border", align_corners=False
        )
        return sampled.view(-1)

    def density(self, unit: Tensor, draws: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Density (n,) per inner unit, input of the colour network (n, geometry), and bypassed colour logits (n, 3)."""
        features = self.grid(unit, draws)
        with mlp_precision(unit.device):
            out = self.density_net(features)
        raw = out[:, 0].float() + BASE_LOG_DENSITY + self.log_prior(unit)
        last = self.sizes.features * (self.sizes.levels - 1)
        return raw.clamp(max=MAX_LOG_DENSITY).exp(), out[:, 1:], features[:, last : last + 3]

    def forward(
        self, unit: Tensor, direction: Tensor, image: Tensor | None = None, draws: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Density (n,) and colour (n, 3) in [0, 1] at unit coordinates, seen along directions (n, 3).

        `image` (n,) selects each point's appearance vector; without it their mean is used.
        """
        density, geometry, bypass = self.density(unit, draws)
        inputs = [geometry]
        if self.sizes.appearance:
            appearance = self.appearance.mean(dim=0).expand(len(unit), -1) if image is None else self.appearance[image]
            inputs.append(appearance)
        if self.sizes.view_direction:
            inputs.append(harmonics(direction))
        with mlp_precision(unit.device):
            logits = self.colour_net(torch.cat([x.to(geometry.dtype) for x in inputs], dim=-1))
        return density, torch.sigmoid(logits.float() + bypass)

    def gains(self, image: Tensor) -> Tensor:
        """Learned gains (n, 3) on the colours of photos; their geometric mean over all photos is 1."""
        if self.sizes.appearance:
            return torch.ones(len(image), 3, device=image.device)
        return (self.log_gain - self.log_gain.mean(dim=0))[image].exp()

    @torch.no_grad()
    def splat(self, unit: Tensor, rgb: Tensor) -> None:
        """Write the mean colours (n, 3) in [0, 1] of points (n, 3) into the finest level."""
        table = self.grid.table[self.grid.finest_first :]
        total, weight = torch.zeros(len(table), 3, device=table.device), torch.zeros(len(table), device=table.device)
        for part, colour in zip(torch.split(unit, 1 << 17), torch.split(rgb, 1 << 17), strict=True):
            rows, weights = self.grid.finest_corners(part)
            logits = torch.logit(colour.clamp(0.02, 0.98))
            weight.index_add_(0, rows.reshape(-1), weights.reshape(-1))
            total.index_add_(0, rows.reshape(-1), (weights[..., None] * logits[:, None]).reshape(-1, 3))
        known = weight > 1e-3
        table[known, :3] = total[known] / weight[known, None]


def harmonics(direction: Tensor) -> Tensor:
    """Real spherical harmonics (n, 9) up to degree 2 of unit directions (n, 3), without their constant factors."""
    x, y, z = direction.unbind(dim=-1)
    one = torch.ones_like(x)
    return torch.stack([one, x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1], dim=-1)


def _mlp(inputs: int, hidden: int, outputs: int, *, layers: int) -> nn.Sequential:
    parts: list[nn.Module] = [nn.Linear(inputs, hidden), nn.ReLU()]
    for _ in range(layers - 1):
        parts += [nn.Linear(hidden, hidden), nn.ReLU()]
    last = nn.Linear(hidden, outputs)
    nn.init.zeros_(last.bias)
    nn.init.zeros_(last.weight[:3] if outputs == 3 else last.weight[:1])
    return nn.Sequential(*parts, last)
