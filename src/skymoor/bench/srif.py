# SPDX-License-Identifier: Apache-2.0
"""SRIF, pairs of images of different sensors with known transforms, in the folders as published.

Li, Xu, Shi, Zhang and Hu, *Multi-modality image matching: a locally normalised method with scale and rotation
invariance* (ISPRS Journal, 2023); the data set is at github.com/LJY-RS/SRIF and is not part of skymoor. A folder for
each kind holds `pairK_1`, `pairK_2` and `gt_K.txt`, the 2 x 3 transform from pixels of the first image to those of the
second, where the centre of the first pixel is (0, 0). Second images are turned, and black beyond their own frame, which
is masked: for a search its edge would be the clearest thing in the image.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image as Pillow

from skymoor.errors import InputError
from skymoor.types import Array, Image, Mask, Raster

KINDS = ("Nighttime", "Optical-Infrared", "Optical-Depth", "Optical-Optical")
LEFT_OUT = {
    "Optical-SAR": "its labels contradict the images in most of the pairs that could be checked",
    "Optical-Map": "all its labels are the identity",
}
BLACK = 12  # at most, of what is beyond the frame, which JPEG does not leave at 0
GRID = 12  # points along each side of the first image
LAYOUT = "it holds Nighttime/pair1_1.jpg, Nighttime/pair1_2.jpg, Nighttime/gt_1.txt and so on"


@dataclass(frozen=True, eq=False)
class Pair:
    """Two images and the true transform.

    Attributes:
        kind, name: the folder, and the number of the pair in it.
        a, b: files of the first and second image.
        b_from_a: (2, 3) from pixels of a to those of b; the centre of the first pixel is (0.5, 0.5).
        content: SHA-256 of the three files.
    """

    kind: str
    name: str
    a: Path
    b: Path
    b_from_a: Array
    content: str

    def rasters(self) -> tuple[Raster, Raster]:
        """Both images, the second with its frame as its mask. Raises `InputError` where one cannot be read."""
        a, b = _read(self.a), _read(self.b)
        return Raster(a, np.ones(a.shape[:2], bool)), Raster(b, inside_frame(b))


def find_pairs(folder: Path, progress: Callable[[int, int], object] = lambda *_: None) -> list[Pair]:
    """All pairs of the kinds with sound labels, by kind and number; every file is read once.

    Raises:
        InputError: the folder is not that of the data set, or a pair lacks a file or has one that cannot be read; one
            line names the file.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; give that of the SRIF data set: {LAYOUT}")
    labels = [file for kind in KINDS for file in sorted((folder / kind).glob("gt_*.txt"), key=_number)]
    if not labels:
        raise InputError(
            f"{folder}: has no pairs of {', '.join(KINDS)}; give the folder of the SRIF data set: {LAYOUT}"
        )
    found = []
    for done, label in enumerate(labels):
        found.append(_pair(label))
        progress(done + 1, len(labels))
    return found


def inside_frame(rgb: Image) -> Mask:
    """Pixels (h, w) of a turned image that are not of the black corners beyond it.

    The frame is convex, so that what is black within it stays, also where it touches a corner.
    """
    dark = (rgb.max(axis=2) <= BLACK).astype(np.uint8)
    labels = cv2.connectedComponents(dark, connectivity=4)[1]
    corners = {int(labels[v, u]) for v in (0, -1) for u in (0, -1)} - {0}
    shown = cv2.morphologyEx(
        (~np.isin(labels, list(corners))).astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5), np.uint8)
    )
    rows, columns = np.nonzero(shown)
    if not corners or not len(rows):
        return np.ones(dark.shape, bool)
    hull = cv2.convexHull(np.column_stack([columns, rows]).astype(np.int32))
    return np.asarray(cv2.fillConvexPoly(np.zeros_like(dark), hull, 1) > 0)


def label_error_px(b_from_a: Array, pair: Pair, shapes: tuple[tuple[int, ...], tuple[int, ...]]) -> float:
    """Mean distance, in pixels of b, from the label, over a grid of points of a that the label puts into b.

    `shapes` (h, w) are those of a and b. Raises `InputError` where the label puts none of them into b.
    """
    (ha, wa), (hb, wb) = (shape[:2] for shape in shapes)
    at = (np.arange(GRID) + 0.5) / GRID
    points = np.stack(np.meshgrid(at * wa, at * ha), axis=-1).reshape(-1, 2)
    true = points @ pair.b_from_a[:, :2].T + pair.b_from_a[:, 2]
    inside = ((true >= 0) & (true <= [wb, hb])).all(axis=1)
    if not inside.any():
        raise InputError(f"{pair.a}: its label puts it beside the second image; take the files from the data set again")
    answer = points @ b_from_a[:, :2].T + b_from_a[:, 2]
    return float(np.linalg.norm(answer - true, axis=1)[inside].mean())


def _pair(label: Path) -> Pair:
    name = label.stem.removeprefix("gt_")
    a, b = (_image_file(label, f"pair{name}_{side}") for side in "12")
    total = hashlib.sha256()
    for file in (a, b, label):
        total.update(hashlib.sha256(file.read_bytes()).digest())
    pair = Pair(label.parent.name, name, a, b, _read_label(label), total.hexdigest())
    first, second = pair.rasters()
    label_error_px(pair.b_from_a, pair, (first.mask.shape, second.mask.shape))
    return pair


def _image_file(label: Path, stem: str) -> Path:
    found = sorted(label.parent.glob(f"{stem}.*"))
    if not found:
        raise InputError(f"{label.parent / stem}.jpg: is missing, and {label.name} is there; complete the data set")
    return found[0]


def _read_label(file: Path) -> Array:
    """The transform in this package's pixels, whose first centre is (0.5, 0.5)."""
    try:
        matrix = np.loadtxt(file, dtype=np.float64)
    except (OSError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (2, 3) or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:, :2])) < 1e-6:
        raise InputError(f"{file}: is no transform of 2 x 3 numbers; take the file from the data set again")
    shift = matrix[:, 2] + 0.5 - matrix[:, :2] @ [0.5, 0.5]
    return np.column_stack([matrix[:, :2], shift])


def _read(file: Path) -> Image:
    try:
        with Pillow.open(file) as image:
            return np.array(image.convert("RGB"), dtype=np.uint8)
    except (OSError, ValueError, SyntaxError, Pillow.DecompressionBombError):
        raise InputError(f"{file}: cannot be read as an image; take the file from the data set again") from None


def _number(file: Path) -> tuple[int, str]:
    digits = re.search(r"\d+", file.stem)
    return (int(digits[0]) if digits else 0, file.stem)
