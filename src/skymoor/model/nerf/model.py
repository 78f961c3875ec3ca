# SPDX-License-Identifier: Apache-2.0
"""The trained radiance field as a scene model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch

from skymoor.engines.libraries import torch_device
from skymoor.model.blend import Blend, BlendOptions
from skymoor.model.nerf._torch import torch_threads
from skymoor.model.nerf.box import INNER_PER_LEVEL
from skymoor.model.nerf.field import Field
from skymoor.model.nerf.options import UncertaintyOptions
from skymoor.model.nerf.render import Layers, render_layers, z_buffer
from skymoor.model.nerf.sampling import Proposal
from skymoor.model.nerf.uncertainty import Deformation, confidence
from skymoor.model.protocol import SceneModel
from skymoor.types import Array, Array32, DepthMap, Image, Progress, Render, View, no_progress

REDUCE = 4  # a photo's z-buffer is a quarter of its size
MIN_OPACITY = 0.5


@dataclass(frozen=True, eq=False)
class NerfModel:
    """A radiance field in the `level` frame, and the undistorted photos with their depths.

    `texture` is the source of colours: "blend" uses the photos at the field's surface, and the field only where no
    photo covers it, "field" uses the field everywhere. `dataclasses.replace` changes it.
    """

    field: Field
    proposal: Proposal
    maps: tuple[DepthMap, ...]
    surface_points: Array
    pixel: float
    blend: BlendOptions
    uncertainty: UncertaintyOptions
    deformation: Deformation | None
    texture: Literal["blend", "field"]
    device: Literal["auto", "cpu", "cuda"] = "auto"
    threads: int = 0

    def render(self, view: View, *, progress: Progress = no_progress) -> Render:
        """Surface, colour and confidence; see `SceneModel`. xyz is NaN for low opacity and without any photo."""
        with torch_threads(self.threads):
            layers = self._layers(view, progress)
            xyz = self.field.box.level_from_inner(layers.xyz.cpu().numpy().astype(np.float64)).astype(np.float32)
            solid = layers.opacity.cpu().numpy() >= MIN_OPACITY
            xyz[~solid] = np.nan
            blend = Blend(xyz, view.view_from_level[2], self.blend)
            for done, depth_map in enumerate(self.maps):
                blend.add(depth_map, self._z_buffers[done])
                progress(done + 1, len(self.maps))
            rgb, agreement = blend.result()
            field_rgb = np.clip(layers.rgb.cpu().numpy() * 255 + 0.5, 0, 255).astype(np.uint8)
            if self.texture == "field":
                rgb = field_rgb
            rgb = np.where(blend.covered[..., None], rgb, np.where(solid[..., None], field_rgb, 0))
            certainty = self._confidence(layers, agreement, view)
            certainty[~solid] = 0
            xyz[~blend.covered] = np.nan
        return Render(view, np.asarray(rgb, dtype=np.uint8), xyz, certainty)

    def field_colours(self, view: View, *, progress: Progress = no_progress) -> Image:
        """The field's own colours (h, w, 3) of a view."""
        with torch_threads(self.threads):
            layers = self._layers(view, progress)
        return np.clip(layers.rgb.cpu().numpy() * 255 + 0.5, 0, 255).astype(np.uint8)

    def _layers(self, view: View, progress: Progress) -> Layers:
        """Layers of a view, computed on `device`."""
        device = torch.device(torch_device(self.device))
        return render_layers(self.field.to(device), self.proposal.to(device), view, progress)

    def _confidence(self, layers: Layers, agreement: Array32, view: View) -> Array32:
        pixel = self.pixel * INNER_PER_LEVEL
        bayes = None
        if self.deformation is not None:
            direction = torch.tensor(view.view_from_level[2], dtype=torch.float32, device=layers.xyz.device)
            along = self.deformation.to(layers.xyz.device).along(self.field, layers.xyz.view(-1, 3), direction)
            bayes = (along.view(layers.t.shape) / pixel).cpu().numpy()
        spread = (layers.spread / pixel).cpu().numpy()
        return confidence(agreement, layers.opacity.cpu().numpy(), spread, bayes, self.uncertainty)

    @cached_property
    def _z_buffers(self) -> tuple[Array32, ...]:
        bins, proposal = self.field.sizes.bins, self.proposal.to(torch.device(torch_device(self.device)))
        return tuple(z_buffer(proposal, depth_map.camera, REDUCE, bins) for depth_map in self.maps)


_model: type[SceneModel] = NerfModel
