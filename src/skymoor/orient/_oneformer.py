# SPDX-License-Identifier: Apache-2.0
"""OneFormer, the paper's ground labels, through the library transformers.

Jain et al., OneFormer: One Transformer to Rule Universal Image Segmentation, CVPR 2023.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from skymoor.engines.libraries import require, torch_device
from skymoor.engines.options import FIXED
from skymoor.engines.weights import find
from skymoor.engines.weights.repository import describes, open_model, reading
from skymoor.errors import InputError
from skymoor.orient._classes import ground_mask
from skymoor.orient.protocol import GroundLabeler
from skymoor.types import Image, Mask


@dataclass(frozen=True)
class OneFormerLabeler:
    """The semantic task of OneFormer: the union of all classes whose names mean ground.

    Attributes:
        weights: folder of a model with a Swin backbone, such as those trained on ADE20K; empty for where
            `skymoor weights fetch oneformer` puts it. The list of its classes may lie in it or beside it.
        device: "auto", "cpu" or "cuda".
        side_px: long side to which photos are reduced; memory grows with its square times the number of classes.
    """

    weights: str = ""
    device: str = field(default="auto", metadata=FIXED)
    side_px: int = 1024

    def ready(self) -> tuple[Path, ...]:
        """The folder that will be read; see `__call__` for what is raised where something is missing."""
        require("transformers", "segmentation")
        return (find("oneformer", "model", self.weights),)

    def __call__(self, image: Image) -> Mask:
        """Ground-like pixels (h, w) of a photo (h, w, 3); see `GroundLabeler`.

        Raises:
            BackendUnavailable: transformers or the weights are missing.
            InputError: the folder holds no OneFormer, not all of it, or one without a class of ground.
        """
        device = torch_device(self.device)
        (folder,) = self.ready()
        processor, network = _network(folder, device)
        return ground_mask(processor, network, image, self.side_px, folder, device, task_inputs=["semantic"])


_: type[GroundLabeler] = OneFormerLabeler


@lru_cache(maxsize=1)
def _network(folder: Path, device: str) -> tuple[Any, Any]:
    transformers = require("transformers", "segmentation")
    # Without the text encoder, which is used in training only.
    network = open_model(transformers.OneFormerForUniversalSegmentation, folder, ("oneformer",), is_training=False)
    class_folder = _folder_of_classes(folder)
    with reading(folder):
        processor = transformers.OneFormerProcessor.from_pretrained(
            folder, repo_path=str(class_folder), local_files_only=True, trust_remote_code=False
        )
    return processor, network.to(device)


def _folder_of_classes(folder: Path) -> Path:
    """Folder of the list of classes; without it the library would download the list from the hub."""
    file = _image_part(folder).get("class_info_file", "ade20k_panoptic.json")
    for class_folder in (folder, folder.parent):
        if (class_folder / file).is_file():
            describes(class_folder, file)
            return class_folder
    raise InputError(f"{folder}: the list of classes {file} is missing; put it into the folder")


def _image_part(folder: Path) -> dict[str, Any]:
    """Preprocessing of photos: a file of its own, or a part of the one that newer versions of the library write."""
    if (folder / "preprocessor_config.json").is_file():
        return describes(folder, "preprocessor_config.json")
    part = describes(folder, "processor_config.json").get("image_processor", {})
    return part if isinstance(part, dict) else {}
