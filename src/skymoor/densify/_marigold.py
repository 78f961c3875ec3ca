# SPDX-License-Identifier: Apache-2.0
"""Marigold, the paper's monocular depth, through the library diffusers.

Ke et al., Repurposing Diffusion-Based Image Generators for Monocular Depth Estimation, CVPR 2024.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from skymoor.densify.protocol import MonocularDepth
from skymoor.engines.libraries import require, torch_device
from skymoor.engines.options import FIXED
from skymoor.engines.weights import find
from skymoor.engines.weights.repository import describes, open_model, reading
from skymoor.errors import InputError
from skymoor.types import Array32, Image


@dataclass(frozen=True)
class MarigoldDepth:
    """Affine depth by denoising: minutes per photo on a CPU.

    Attributes:
        weights: folder of the model; empty for where `skymoor weights fetch marigold` puts it.
        device: "auto", "cpu" or "cuda"; half precision on CUDA only.
        side_px: long side of the network's input; the result has the size of the photo.
        steps: of denoising; 0 for the model's default.
        ensemble: number of predictions, which are aligned and their median taken.
        seed: of the noise.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    side_px: int = 768
    steps: int = 0
    ensemble: int = 1
    seed: int = field(default=0, metadata=FIXED)

    def __post_init__(self) -> None:
        if self.side_px < 64 or self.steps < 0 or self.ensemble < 1:
            raise InputError(
                f"side_px = {self.side_px}, steps = {self.steps}, ensemble = {self.ensemble}: 64, 0 and 1 at least"
            )

    def ready(self) -> tuple[Path, ...]:
        """The folder that will be read; see `__call__` for what is raised where something is missing."""
        require("transformers", "depth")
        require("diffusers", "depth")
        return (find("marigold", "model", self.weights),)

    def __call__(self, image: Image) -> Array32:
        """Depth (h, w) from 0, nearest, to 1, farthest; see `MonocularDepth`.

        Raises:
            BackendUnavailable: diffusers, transformers or the weights are missing.
            InputError: the folder has no Marigold for depth, or not all of it.
        """
        device = torch_device(self.device)
        pipeline = _pipeline(*self.ready(), device)
        import torch
        from PIL import Image as PilImage

        output = pipeline(
            PilImage.fromarray(image),
            num_inference_steps=self.steps or None,
            ensemble_size=self.ensemble,
            processing_resolution=min(self.side_px, max(image.shape[:2])),
            generator=torch.Generator(device).manual_seed(self.seed),
        )
        return np.asarray(output.prediction[0, :, :, 0], np.float32)


_: type[MonocularDepth] = MarigoldDepth


@lru_cache(maxsize=1)
def _pipeline(folder: Path, device: str) -> Any:
    diffusers, transformers = require("diffusers", "depth"), require("transformers", "depth")
    import torch

    index = describes(folder, "model_index.json")
    kind = index.get("_class_name")
    if kind != "MarigoldDepthPipeline" or index.get("prediction_type") not in (None, "depth"):
        raise InputError(f"{folder}: holds a {kind}, not a MarigoldDepthPipeline; give another folder")
    dtype = torch.float16 if device == "cuda" else torch.float32
    # The pipeline itself would fill missing weights of its parts with random numbers.
    safe: dict[str, Any] = {"dtype": dtype, "use_safetensors": True}
    unet = open_model(diffusers.UNet2DConditionModel, folder / "unet", ("UNet2DConditionModel",), **safe)
    vae = open_model(diffusers.AutoencoderKL, folder / "vae", ("AutoencoderKL",), **safe)
    text_encoder = open_model(transformers.CLIPTextModel, folder / "text_encoder", (), **safe)
    with reading(folder):
        pipeline = diffusers.MarigoldDepthPipeline.from_pretrained(
            folder, unet=unet, vae=vae, text_encoder=text_encoder, local_files_only=True, dtype=dtype
        )
    pipeline.set_progress_bar_config(disable=True)
    return pipeline.to(device)
