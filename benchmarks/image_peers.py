# SPDX-License-Identifier: Apache-2.0
"""Feature matchers of others, with a similarity by RANSAC on their matches: what the search is compared with.

Those whose descriptors do not bear any rotation get the first image at several headings, and the one with most inliers
counts: as many headings as it takes to come near enough (RIFT-like descriptors bear 8 degrees, XFeat's and matching
networks some 20). Networks run through kornia, on weights from files; skymoor brings none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rift import rift_features

from skymoor.bench import Answer, Method, similarity_from
from skymoor.types import Raster

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

KEYPOINTS = 2048
LEARNED_KEYPOINTS = 1024  # of matching networks, whose time grows with the square
SIFT_RATIO, ALIKED_RATIO = 0.85, 0.98
RIFT_PX = 400  # side of larger images, whose phase congruency takes seconds a heading


@dataclass(frozen=True, eq=False)
class Described:
    """Key points (n, 2), the centre of the first pixel at (0.5, 0.5), descriptors (n, d), and the image's (w, h)."""

    px: Array
    descriptors: NDArray[np.float32]
    size: tuple[int, int]


@dataclass(frozen=True)
class Peer:
    """One of them.

    Attributes:
        name: in tables.
        headings: at which the first image is tried.
        weights: names of the files that it needs.
        make: its features and its matches, from the paths of these files.
    """

    name: str
    headings: int
    weights: tuple[str, ...]
    make: Callable[..., tuple[Callable[[Raster], Described], Callable[[Described, Described], tuple[Indices, Indices]]]]

    def method(self, folders: Sequence[Path]) -> Method | None:
        """Ready to use, or None where a file is in none of the folders."""
        found = [next((file for folder in folders for file in folder.rglob(name)), None) for name in self.weights]
        if None in found:
            return None
        describe, match = self.make(*found)
        return partial(tried, self.headings, describe, match)


def tried(
    headings: int,
    describe: Callable[[Raster], Described],
    match: Callable[[Described, Described], tuple[Indices, Indices]],
    a: Raster,
    b: Raster,
) -> Answer:
    """The heading of a with most inliers."""
    in_b, best = describe(b), Answer(None)
    for k in range(headings):
        turned, turned_from_a = rotated(a, 2 * np.pi * k / headings)
        in_a = describe(turned)
        if min(len(in_a.px), len(in_b.px)) < 4:
            continue
        i, j = match(in_a, in_b)
        px_a = (in_a.px[i] - turned_from_a[:, 2]) @ np.linalg.inv(turned_from_a[:, :2]).T
        found = similarity_from(px_a, in_b.px[j])
        best = max(best, found, key=lambda one: one.inliers)
    return best


def rotated(a: Raster, angle: float) -> tuple[Raster, Array]:
    """The image turned in a frame that holds all of it, and the transform to its pixels."""
    if angle == 0:
        return a, np.eye(2, 3)
    h, w = a.mask.shape
    c, s = np.cos(angle), np.sin(angle)
    linear = np.array([[c, -s], [s, c]])
    size = np.ceil(np.abs(linear) @ [w, h]).astype(int)
    matrix = np.column_stack([linear, size / 2 - linear @ [w / 2, h / 2]])
    in_opencv = matrix.copy()
    in_opencv[:, 2] += linear @ [0.5, 0.5] - 0.5
    shape = (int(size[0]), int(size[1]))
    rgb = cv2.warpAffine(a.rgb, in_opencv, shape, flags=cv2.INTER_LINEAR)
    mask = cv2.warpAffine(a.mask.astype(np.uint8), in_opencv, shape, flags=cv2.INTER_NEAREST) > 0
    return Raster(np.asarray(rgb, np.uint8), mask), matrix


def mutual(ratio: float, a: Described, b: Described) -> tuple[Indices, Indices]:
    """Each other's nearest descriptors, where the second nearest is farther by `ratio`; 1 asks for nothing."""
    squares = (a.descriptors**2).sum(1)[:, None] + (b.descriptors**2).sum(1) - 2 * a.descriptors @ b.descriptors.T
    nearest, back = squares.argmin(axis=1), squares.argmin(axis=0)
    i = np.flatnonzero(back[nearest] == np.arange(len(nearest)))
    if ratio < 1:
        two = np.sqrt(np.maximum(np.partition(squares[i], 1, axis=1)[:, :2], 0))
        i = i[two[:, 0] < ratio * two[:, 1]]
    return i, nearest[i]


def _sift() -> tuple[Any, Any]:
    def describe(image: Raster) -> Described:
        points, found = cv2.SIFT_create(KEYPOINTS).detectAndCompute(_grey(image), image.mask.astype(np.uint8) * 255)
        px = np.array([point.pt for point in points], np.float64).reshape(-1, 2) + 0.5
        return Described(px, np.empty((0, 128), np.float32) if found is None else found, _size(image))

    return describe, partial(mutual, SIFT_RATIO)


def _rift() -> tuple[Any, Any]:
    def describe(image: Raster) -> Described:
        factor = min(1.0, RIFT_PX / float(np.sqrt(image.mask.sum())))
        size = (round(image.mask.shape[1] * factor), round(image.mask.shape[0] * factor))
        grey = cv2.resize(_grey(image), size, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(image.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        px, found = rift_features(np.asarray(grey, np.uint8), mask)
        return Described(px / factor, found, _size(image))

    return describe, partial(mutual, 1.0)


def _aliked(weights: Path, most: int = KEYPOINTS) -> tuple[Any, Any]:
    from skymoor.engines.aliked import AlikedFeatures

    features = AlikedFeatures(str(weights), "cpu", max_keypoints=most)

    def describe(image: Raster) -> Described:
        px, found = features(image.rgb)
        return _inside(Described(px, found.numpy(), _size(image)), image)

    return describe, partial(mutual, ALIKED_RATIO)


def _aliked_lightglue(weights: Path, network: Path) -> tuple[Any, Any]:
    return _aliked(weights, LEARNED_KEYPOINTS)[0], partial(_by_lightglue, "aliked", network)


def _xfeat(weights: Path, most: int = KEYPOINTS) -> tuple[Any, Any]:
    import torch
    from kornia.feature import XFeat

    network = XFeat(top_k=most).eval()
    network.net.load_state_dict(torch.load(weights, weights_only=True))

    def describe(image: Raster) -> Described:
        tensor = torch.from_numpy(np.ascontiguousarray(image.rgb)).permute(2, 0, 1)[None].float() / 255
        with torch.inference_mode():
            found = network.detectAndCompute(tensor, top_k=most)[0]
        px = found["keypoints"].numpy().astype(np.float64) + 0.5
        return _inside(Described(px, found["descriptors"].numpy(), _size(image)), image)

    return describe, partial(mutual, 1.0)


def _xfeat_lighterglue(weights: Path, network: Path) -> tuple[Any, Any]:
    return _xfeat(weights, LEARNED_KEYPOINTS)[0], partial(_by_lightglue, "xfeat", network)


def _by_lightglue(kind: str, weights: Path, a: Described, b: Described) -> tuple[Indices, Indices]:
    import torch

    def given(one: Described) -> dict[str, Any]:
        px = torch.from_numpy((one.px - 0.5).astype(np.float32))[None]
        return {
            "keypoints": px,
            "descriptors": torch.from_numpy(one.descriptors)[None],
            "image_size": torch.tensor([one.size], dtype=torch.float32),
        }

    with torch.inference_mode():
        found = _lightglue(kind, weights)({"image0": given(a), "image1": given(b)})
    pairs = found["matches"][0].numpy()
    return pairs[:, 0], pairs[:, 1]


@lru_cache(maxsize=2)
def _lightglue(kind: str, weights: Path) -> Any:
    import torch
    from kornia.feature import LightGlue

    network = LightGlue(features=None, **{**LightGlue.features[kind], "weights": None}).eval()
    state = torch.load(weights, weights_only=True, map_location="cpu")
    if kind == "xfeat":  # the file holds the detector too
        state = {key.removeprefix("matcher."): value for key, value in state.items() if key.startswith("matcher.")}
    missing, unexpected = network.load_state_dict(state, strict=False)
    if set(missing) - {"confidence_thresholds"} or unexpected:
        raise SystemExit(f"{weights}: are not weights of this network: {missing[:3]} {unexpected[:3]}")
    return network


def _inside(found: Described, image: Raster) -> Described:
    """Without key points beside the image, or on its turned border."""
    inner = cv2.erode(image.mask.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    h, w = image.mask.shape
    column, row = np.clip(found.px.astype(int), 0, [w - 1, h - 1]).T
    kept = inner[row, column]
    return replace(found, px=found.px[kept], descriptors=found.descriptors[kept])


def _grey(image: Raster) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(image.rgb, cv2.COLOR_RGB2GRAY), np.uint8)


def _size(image: Raster) -> tuple[int, int]:
    return image.mask.shape[1], image.mask.shape[0]


ALIKED, ALIKED_GLUE = "aliked-n16rot.pth", "aliked_lightglue.pth"
XFEAT, XFEAT_GLUE = "xfeat.pt", "xfeat-lighterglue.pt"
PEERS = (
    Peer("SIFT", 1, (), _sift),
    Peer("RIFT-like", 24, (), _rift),
    Peer("ALIKED n16rot", 4, (ALIKED,), _aliked),
    Peer("XFeat", 8, (XFEAT,), _xfeat),
    Peer("XFeat + LighterGlue", 8, (XFEAT, XFEAT_GLUE), _xfeat_lighterglue),
    Peer("ALIKED n16rot + LightGlue", 8, (ALIKED, ALIKED_GLUE), _aliked_lightglue),
)
