# SPDX-License-Identifier: Apache-2.0
"""Every engine, configured once: stages choose theirs by name, and several may choose the same."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, TypeVar

from skymoor.densify import (
    DepthAnythingDepth,
    DepthEstimator,
    MarigoldDepth,
    MetricDepth,
    MetricDepthNetwork,
    MonocularDepth,
    PatchMatchDepth,
    SgmDepth,
)
from skymoor.engines.options import FIXED
from skymoor.errors import BackendUnavailable
from skymoor.match import AlikedMatcher as DenseAliked
from skymoor.match import (
    AnyLocRetriever,
    ChannelRetriever,
    DenseMatcher,
    LoftrMatcher,
    PointMatcher,
    Retriever,
    RomaMatcher,
    RomaV2Matcher,
    StructuralMatcher,
    TinyRomaMatcher,
    XfeatMatcher,
)
from skymoor.orient import GroundLabeler, OneFormerLabeler, SemanticLabeler
from skymoor.reconstruct import (
    AlikedPairMatcher,
    ColmapAlikedMatcher,
    ConflictFilter,
    DedodeDetector,
    DedodeRomaMatcher,
    DoppelgangerClassifier,
    PairFilter,
    PairMatcher,
    SiftMatcher,
)

E = TypeVar("E")

PairMatcherName = Literal["sift", "aliked", "dedode_roma", "colmap_aliked"]
PairFilterName = Literal["none", "conflicts", "doppelgangers"]
DenseMatcherName = Literal["structural", "aliked", "loftr", "tiny_roma", "roma", "romav2"]
PointMatcherName = Literal["auto", "none", "xfeat"]
RetrieverName = Literal["channels", "anyloc"]
StereoName = Literal["sgm", "patchmatch"]
RelativeDepthName = Literal["none", "marigold", "depth_anything"]
MetricDepthName = Literal["none", "metric_depth"]
LabelerName = Literal["none", "oneformer", "semantic"]


@dataclass(frozen=True)
class Engines:
    """Where engines find their weights, and at which size they work; docs/engines.md says what each is good for.

    Attributes:
        device: of all learned engines; "auto" takes CUDA where there is one.
        sift, aliked, dedode, colmap_aliked: features of photos; ALIKED also matches the render with the reference.
        conflicts, doppelgangers: find pairs of photos of different but similar structures.
        structural, loftr, tiny_roma, roma, romav2: match the render with the reference, or photos with tiles.
        xfeat: matches key points of walls.
        channels, anyloc: say which tiles a ground photo may show.
        sgm, patchmatch: dense stereo.
        marigold, depth_anything, metric_depth: depth of single photos.
        oneformer, semantic: label the ground in photos.
    """

    device: Literal["auto", "cpu", "cuda"] = "auto"
    sift: SiftMatcher = field(default_factory=SiftMatcher)
    aliked: AlikedPairMatcher = field(default_factory=AlikedPairMatcher)
    dedode: DedodeDetector = field(default_factory=DedodeDetector)
    colmap_aliked: ColmapAlikedMatcher = field(default_factory=ColmapAlikedMatcher)
    conflicts: ConflictFilter = field(default_factory=ConflictFilter, metadata=FIXED)
    doppelgangers: DoppelgangerClassifier = field(default_factory=DoppelgangerClassifier)
    structural: DenseMatcher = field(default_factory=StructuralMatcher, metadata=FIXED)
    loftr: LoftrMatcher = field(default_factory=LoftrMatcher)
    tiny_roma: TinyRomaMatcher = field(default_factory=TinyRomaMatcher)
    roma: RomaMatcher = field(default_factory=RomaMatcher)
    romav2: RomaV2Matcher = field(default_factory=RomaV2Matcher)
    xfeat: XfeatMatcher = field(default_factory=XfeatMatcher)
    channels: ChannelRetriever = field(default_factory=ChannelRetriever, metadata=FIXED)
    anyloc: AnyLocRetriever = field(default_factory=AnyLocRetriever)
    sgm: SgmDepth = field(default_factory=SgmDepth)
    patchmatch: PatchMatchDepth = field(default_factory=PatchMatchDepth)
    marigold: MarigoldDepth = field(default_factory=MarigoldDepth)
    depth_anything: DepthAnythingDepth = field(default_factory=DepthAnythingDepth)
    metric_depth: MetricDepthNetwork = field(default_factory=MetricDepthNetwork)
    oneformer: OneFormerLabeler = field(default_factory=OneFormerLabeler)
    semantic: SemanticLabeler = field(default_factory=SemanticLabeler)

    def pair_matcher(self, name: PairMatcherName, *, shared_camera: bool, exhaustive_below: int) -> PairMatcher:
        """What finds common points of photos, for photos of one camera or of several."""
        dedode_roma = DedodeRomaMatcher(self.dense_matcher("roma"), self._on_device(self.dedode))
        aliked = replace(self.aliked, features=self._on_device(self.aliked.features))
        engines: dict[str, Any] = {"sift": self.sift, "aliked": aliked, "colmap_aliked": self.colmap_aliked}
        chosen = {**engines, "dedode_roma": dedode_roma}[name]
        found: PairMatcher = replace(chosen, shared_camera=shared_camera, exhaustive_below=exhaustive_below)
        return found

    def pair_filter(self, name: PairFilterName) -> PairFilter | None:
        """What finds pairs of look-alikes; None for "none"."""
        found: PairFilter | None = self._named(name)
        return found

    def dense_matcher(self, name: DenseMatcherName) -> DenseMatcher:
        """What matches two rasters densely."""
        if name == "aliked":
            features = self.aliked.features
            return DenseAliked(features.weights, self.device, features.max_keypoints, side_px=features.side_px)
        found: DenseMatcher = self._named(name)
        return found

    def point_matcher(self, name: PointMatcherName) -> PointMatcher | None:
        """What matches key points of walls: with "auto" XFeat where it can run; None for "none"."""
        if name == "none":
            return None
        xfeat: XfeatMatcher = self._on_device(self.xfeat)
        if name == "auto":
            try:
                xfeat.ready()
            except BackendUnavailable:
                return None
        return xfeat

    def retriever(self, name: RetrieverName) -> Retriever:
        """What says which tiles a photo may show."""
        found: Retriever = self._named(name)
        return found

    def stereo(self, name: StereoName) -> DepthEstimator:
        """What measures depth."""
        found: DepthEstimator = self._named(name)
        return found

    def relative_depth(self, name: RelativeDepthName) -> MonocularDepth | None:
        """What ranks depths of single photos; None for "none"."""
        found: MonocularDepth | None = self._named(name)
        return found

    def metric_scale(self, name: MetricDepthName) -> MetricDepth | None:
        """What knows metres of single photos; None for "none"."""
        found: MetricDepth | None = self._named(name)
        return found

    def labeler(self, name: LabelerName) -> GroundLabeler | None:
        """What labels the ground in photos; None for "none"."""
        found: GroundLabeler | None = self._named(name)
        return found

    def _named(self, name: str) -> Any:
        return None if name == "none" else self._on_device(getattr(self, name))

    def _on_device(self, engine: E) -> E:
        has_device = any(item.name == "device" for item in fields(engine))  # type: ignore[arg-type]
        return replace(engine, device=self.device) if has_device else engine  # type: ignore[type-var]
