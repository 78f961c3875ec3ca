# SPDX-License-Identifier: Apache-2.0
"""Ground labels for a CPU: any semantic segmentation of the library transformers.

The weights that `skymoor weights fetch upernet-tiny` gets are UperNet's (Xiao et al., ECCV 2018) on a tiny ConvNeXt
(Liu et al., CVPR 2022), trained on ADE20K: their licence permits every use, SegFormer's does not.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from skymoor.engines.libraries import require, torch_device
from skymoor.engines.options import FIXED
from skymoor.engines.weights import find
from skymoor.engines.weights.repository import open_model, reading
from skymoor.orient._classes import ground_mask
from skymoor.orient.protocol import GroundLabeler
from skymoor.types import Image, Mask


@dataclass(frozen=True)
class SemanticLabeler:
    """The union of all classes whose names mean ground.

    Attributes:
        weights: folder of a model for semantic segmentation: UperNet, BEiT, DPT, SegFormer or another; empty for where
            `skymoor weights fetch upernet-tiny` puts one.
        device: "auto", "cpu" or "cuda".
        side_px: long side to which photos are reduced; memory grows with its square times the number of classes.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    side_px: int = 1024

    def ready(self) -> tuple[Path, ...]:
        """The folder that will be read; see `__call__` for what is raised where something is missing."""
        require("transformers", "segmentation")
        return (find("upernet-tiny", "model", self.weights),)

    def __call__(self, image: Image) -> Mask:
        """Ground-like pixels (h, w) of a photo (h, w, 3); see `GroundLabeler`.

        Raises:
            BackendUnavailable: transformers or the weights are missing.
            InputError: the folder holds no such model, not all of it, or one without a class of ground.
        """
        device = torch_device(self.device)
        (folder,) = self.ready()
        processor, network = _network(folder, device)
        return ground_mask(processor, network, image, self.side_px, folder, device)


_: type[GroundLabeler] = SemanticLabeler


@lru_cache(maxsize=1)
def _network(folder: Path, device: str) -> tuple[Any, Any]:
    transformers = require("transformers", "segmentation")
    # Otherwise the library prompts on the terminal for permission to run code of the folder.
    network = open_model(transformers.AutoModelForSemanticSegmentation, folder, (), trust_remote_code=False)
    with reading(folder):
        processor = transformers.AutoImageProcessor.from_pretrained(
            folder, local_files_only=True, trust_remote_code=False
        )
    return processor, network.to(device)
