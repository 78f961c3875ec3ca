# SPDX-License-Identifier: Apache-2.0
"""Ground classes of segmentation networks, and their inference on a photo."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skymoor.errors import InputError
from skymoor.types import Image, Mask

# Names in ADE20K, Cityscapes and COCO. Steps, bridges and slopes are left out: they are not level, or not low.
GROUND_NAMES = {
    *("road", "route", "street", "crosswalk", "lane marking", "sidewalk", "pavement", "path", "alley", "runway"),
    *("parking", "parking lot", "dirt track", "dirt road", "rail track", "field", "playingfield", "lawn", "grass"),
    *("earth", "ground", "soil", "land", "terrain", "dirt", "gravel", "sand", "beach", "mud", "floor", "flooring"),
    *("water", "sea", "ocean", "river", "lake", "pond", "swimming pool"),
}


def ground_ids(names: Mapping[int, str], folder: Path) -> list[int]:
    """Numbers of the classes that are ground, by their names.

    A name may be a list of words that mean the same ("road, route"), or have a remark behind a hyphen ("water-other").
    Whole words count: a waterfall and a grasshopper are not ground.

    Args:
        names: of the classes, by number.
        folder: of the model, for the error.

    Raises:
        InputError: no class is ground.
    """
    ids = [int(k) for k, name in names.items() if GROUND_NAMES & {_base_name(word) for word in name.split(",")}]
    if not ids:
        some = ", ".join(list(names.values())[:3])
        raise InputError(f"{folder}: none of its classes ({some}, ...) is ground; use a model trained on ADE20K")
    return ids


def ground_mask(
    processor: Any, network: Any, image: Image, side_px: int, folder: Path, device: str, **tasks: list[str]
) -> Mask:
    """Ground-like pixels (h, w) of a photo (h, w, 3), by a segmentation network of the library transformers.

    Args:
        processor, network: of the library, from `folder`.
        image: the photo; it is reduced to the long side `side_px`.
        tasks: further arguments of the processor.

    Raises `InputError` where no class is ground.
    """
    import torch
    from PIL import Image as PilImage

    ids = ground_ids(network.config.id2label, folder)
    photo = small(image, side_px)
    inputs = processor(images=PilImage.fromarray(photo), return_tensors="pt", **tasks).to(device)
    with torch.inference_mode():
        outputs = network(**inputs)
        (labels,) = processor.post_process_semantic_segmentation(outputs, target_sizes=[photo.shape[:2]])
    return ground_of(labels.cpu().numpy(), ids, image)


def ground_of(labels: np.ndarray[tuple[int, ...], np.dtype[np.int64]], ids: list[int], image: Image) -> Mask:
    """Whether pixels are of these classes: labels (h', w') of a reduced photo, at the size (h, w) of the photo."""
    ground = np.isin(labels, ids).astype(np.uint8)
    h, w = image.shape[:2]
    return np.asarray(cv2.resize(ground, (w, h), interpolation=cv2.INTER_NEAREST) > 0)


def small(image: Image, side_px: int) -> Image:
    """A photo reduced to this long side, never enlarged."""
    h, w = image.shape[:2]
    ratio = side_px / max(h, w)
    if ratio >= 1:
        return image
    size = (max(1, round(w * ratio)), max(1, round(h * ratio)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _base_name(word: str) -> str:
    return word.split("-")[0].strip().lower().replace("_", " ")
