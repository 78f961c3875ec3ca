# SPDX-License-Identifier: Apache-2.0
"""Every engine that reads weights: how to call it, what it needs, and what it says that it lacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch

from skymoor.densify import DepthAnythingDepth, MarigoldDepth, MetricDepthNetwork
from skymoor.engines.aliked import AlikedFeatures
from skymoor.match import (
    AlikedMatcher,
    AnyLocRetriever,
    LoftrMatcher,
    RomaMatcher,
    RomaV2Matcher,
    TinyRomaMatcher,
    XfeatMatcher,
)
from skymoor.orient import OneFormerLabeler, SemanticLabeler
from skymoor.reconstruct import AlikedPairMatcher, DedodeDetector, DoppelgangerClassifier, ViewGraph
from skymoor.types import Photos, Raster
from support import hub
from support.pictures import noise_picture

PHOTO = noise_picture((90, 120))
RASTER = Raster(PHOTO, np.ones((90, 120), bool))
NO_PAIRS = ViewGraph(Photos((), (), lambda _: PHOTO), (), (), ())


@dataclass(frozen=True)
class Engine:
    """One of them.

    Attributes:
        kind: its class.
        call: runs it with the path of its weights; empty for where they are fetched to.
        weights: the name by which they are fetched.
        library, extra: the library that it cannot do without, and what installs that.
        good: makes a folder that it can read, of those that read folders.
        part: which folder in there is spoiled; empty for the folder itself.
        lost: a part of the name of a tensor that it cannot do without.
    """

    kind: type
    call: Callable[[str], object]
    weights: str
    library: str = ""
    extra: str = ""
    good: Callable[[Path], Path] | None = None
    part: str = ""
    lost: str = ""


def lightglue(path: str) -> object:
    """Joins two photos without key points; the first weights that it asks for are those of ALIKED."""
    nothing = np.zeros((0, 2)), torch.zeros(0, 128)
    matcher = AlikedPairMatcher(AlikedFeatures(path, "cpu"), "lightglue", path)
    return matcher._lightglue(nothing, nothing, (120, 90), (120, 90))


FILES = (
    Engine(AlikedMatcher, lambda p: AlikedMatcher(p, "cpu")(RASTER, RASTER), "aliked", "kornia.feature", "kornia"),
    Engine(LoftrMatcher, lambda p: LoftrMatcher(p, "cpu")(RASTER, RASTER), "loftr", "kornia.feature", "kornia"),
    Engine(TinyRomaMatcher, lambda p: TinyRomaMatcher(p, "cpu")(RASTER, RASTER), "tiny-roma", "romatch", "roma"),
    Engine(RomaMatcher, lambda p: RomaMatcher(p, p, "cpu")(RASTER, RASTER), "roma", "romatch", "roma"),
    Engine(RomaV2Matcher, lambda p: RomaV2Matcher(True, p)(RASTER, RASTER), "romav2", "romav2", "romav2"),
    Engine(XfeatMatcher, lambda p: XfeatMatcher(p, "cpu")(RASTER, RASTER), "xfeat", "kornia.feature", "kornia"),
    Engine(DedodeDetector, lambda p: DedodeDetector(p, "cpu")(PHOTO), "dedode-b", "kornia.feature", "kornia"),
    Engine(AlikedPairMatcher, lightglue, "aliked", "kornia.feature", "kornia"),
    Engine(DoppelgangerClassifier, lambda p: DoppelgangerClassifier(p, "cpu")(NO_PAIRS), "doppelgangers"),
)
FOLDERS = (
    Engine(
        OneFormerLabeler, lambda p: OneFormerLabeler(p, "cpu")(PHOTO), "oneformer",
        "transformers", "segmentation", hub.oneformer, lost="decoder.class_embed",
    ),
    Engine(
        SemanticLabeler, lambda p: SemanticLabeler(p, "cpu")(PHOTO), "upernet-tiny",
        "transformers", "segmentation", hub.upernet, lost="decode_head.classifier",
    ),
    Engine(
        MarigoldDepth, lambda p: MarigoldDepth(p, "cpu", side_px=64)(PHOTO), "marigold",
        "diffusers", "depth", hub.marigold, part="unet", lost="conv_out.weight",
    ),
    Engine(
        DepthAnythingDepth, lambda p: DepthAnythingDepth(p, "cpu")(PHOTO), "depth-anything-small",
        "transformers", "depth", partial(hub.depth_anything, kind="relative"), lost="head.conv3",
    ),
    Engine(
        MetricDepthNetwork, lambda p: MetricDepthNetwork(p, "cpu")(PHOTO, 500.0), "metric-depth-small",
        "transformers", "depth", partial(hub.depth_anything, kind="metric"), lost="head.conv3",
    ),
    Engine(
        AnyLocRetriever, lambda p: AnyLocRetriever(p, device="cpu", clusters=2)([RASTER], [RASTER]), "dinov2-giant",
        "transformers", "retrieval", hub.dinov2, lost="layer.2.norm1.weight",
    ),
)  # fmt: skip
