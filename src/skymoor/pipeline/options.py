# SPDX-License-Identifier: Apache-2.0
"""Every option of every stage, by its dotted name: each stage owns its own, here they meet."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from skymoor.densify import AgreementOptions, MetricDepthOptions, MonocularDepth, RelativeDepthOptions, StereoOptions
from skymoor.engines.choice import files_of
from skymoor.ground import JointOptions
from skymoor.ground.tiles import CascadeOptions, ConsensusOptions
from skymoor.ground.walls import GroundOptions
from skymoor.match import CyclicOptions, DecoyOptions, MatcherOptions, RetrieverOptions, SearchOptions
from skymoor.model import MeshBuilder, NerfBuilder, RenderOptions, SceneBuilder
from skymoor.orient import LabelOptions, OrientOptions, UprightOptions
from skymoor.reconstruct import (
    AlikedPairMatcher,
    ColmapAlikedMatcher,
    DedodeRomaMatcher,
    PairFilterOptions,
    PairMatcherOptions,
    ReconstructOptions,
    SiftMatcher,
    ground_options,
)
from skymoor.registration import LiftOptions, RegisterOptions, ReliefOptions


@dataclass(frozen=True)
class MatchOptions:
    """From the nadir render to pixels of the reference.

    Attributes:
        min_height_m, max_height_m: flying heights that are searched: the scale of a levelled model.
        candidates: placements that are matched densely; the one with most independent inliers is believed.
        min_height_confidence: heights of the render below it are neither matched nor compared nor written.
        search, decoys, dense, cyclic: of the steps.
    """

    min_height_m: float = 20.0
    max_height_m: float = 200.0
    candidates: int = 3
    min_height_confidence: float = 0.2
    search: SearchOptions = field(default_factory=SearchOptions)
    decoys: DecoyOptions = field(default_factory=DecoyOptions)
    dense: MatcherOptions = field(default_factory=MatcherOptions)
    cyclic: CyclicOptions = field(default_factory=CyclicOptions)


@dataclass(frozen=True)
class ModelOptions:
    """Which model of the airborne set is rendered.

    Attributes:
        kind: "mesh" for fused depth maps, which takes seconds; "nerf" for the radiance field, which takes minutes, is
            closer to the surface and knows better where it is not.
        monocular: whose depths of single photos rank the depths of the radiance field, where photos measure none.
        nerf, mesh: how each is set up.
    """

    kind: Literal["mesh", "nerf"] = "mesh"
    monocular: RelativeDepthOptions = field(default_factory=RelativeDepthOptions)
    nerf: NerfBuilder = field(default_factory=NerfBuilder)
    mesh: MeshBuilder = field(default_factory=MeshBuilder)

    @property
    def builder(self) -> SceneBuilder:
        """The chosen one."""
        return self.nerf if self.kind == "nerf" else self.mesh

    @property
    def ranking(self) -> MonocularDepth | None:
        """What ranks depths; None where nothing does."""
        chosen: MonocularDepth | None = self.monocular.engine
        return chosen if self.kind == "nerf" else None


def _pair_matcher(*, shared_camera: bool, exhaustive_below: int) -> PairMatcherOptions:
    """All matchers of photos, for photos of one camera or of several. Those of the paper are DeDoDe and RoMa."""
    common: dict[str, Any] = {"shared_camera": shared_camera, "exhaustive_below": exhaustive_below}
    return PairMatcherOptions(
        sift=SiftMatcher(**common),
        aliked=AlikedPairMatcher(**common),
        dedode_roma=DedodeRomaMatcher(MatcherOptions(kind="roma"), **common),
        colmap_aliked=ColmapAlikedMatcher(**common),
    )


def _reconstruct() -> ReconstructOptions:
    matcher = _pair_matcher(shared_camera=True, exhaustive_below=40)
    return ReconstructOptions(matcher, pair_filter=PairFilterOptions())


def _reconstruct_ground() -> ReconstructOptions:
    matcher = _pair_matcher(shared_camera=False, exhaustive_below=60)
    return replace(ground_options(), matcher=matcher, pair_filter=PairFilterOptions(kind="conflicts"))


def _cascade() -> CascadeOptions:
    return CascadeOptions(retriever=RetrieverOptions())


@dataclass(frozen=True)
class GroundSetOptions:
    """From ground photos to the airborne model.

    Attributes:
        reconstruct, densify: as for the airborne set, for photos of several lenses from nearby.
        upright: how up is found.
        labels: which network says where the ground is; the cameras' height above it is the unit of the search.
        metric: which network says how many metres that is, so that less has to be searched.
        method: how a component is laid on the airborne model. "walls" compares the walls of both models and needs no
            learned matcher; "cascade" and "exhaustive" match the photos with tiles of the airborne model's renders by
            `matcher`, few of the pairs or all as in the paper.
        place: of "walls"; every component's cameras are heard with it.
        matcher, cascade, exhaustive: of the other two.
        joint: when components contradict each other.
    """

    method: Literal["walls", "cascade", "exhaustive"] = "walls"
    reconstruct: ReconstructOptions = field(default_factory=_reconstruct_ground)
    densify: StereoOptions = field(default_factory=StereoOptions)
    upright: UprightOptions = field(default_factory=UprightOptions)
    labels: LabelOptions = field(default_factory=LabelOptions)
    metric: MetricDepthOptions = field(default_factory=MetricDepthOptions)
    place: GroundOptions = field(default_factory=GroundOptions)
    matcher: MatcherOptions = field(default_factory=MatcherOptions)
    cascade: CascadeOptions = field(default_factory=_cascade)
    exhaustive: ConsensusOptions = field(default_factory=ConsensusOptions)
    joint: JointOptions = field(default_factory=JointOptions)

    @property
    def engines(self) -> tuple[object, ...]:
        """All that a run with ground photos will call."""
        tiles = () if self.method == "walls" else (self.matcher,)
        retriever = (self.cascade.retriever,) if self.method == "cascade" else ()
        return (self.reconstruct, self.densify, self.labels, self.metric, *tiles, *retriever)


@dataclass(frozen=True)
class Options:
    """Every option of every stage, by its dotted name."""

    reconstruct: ReconstructOptions = field(default_factory=_reconstruct)
    orient: OrientOptions = field(default_factory=OrientOptions)
    labels: LabelOptions = field(default_factory=LabelOptions)
    densify: StereoOptions = field(default_factory=StereoOptions)
    agreement: AgreementOptions = field(default_factory=AgreementOptions)
    model: ModelOptions = field(default_factory=ModelOptions)
    render: RenderOptions = field(default_factory=RenderOptions)
    match: MatchOptions = field(default_factory=MatchOptions)
    lift: LiftOptions = field(default_factory=LiftOptions)
    register: RegisterOptions = field(default_factory=RegisterOptions)
    relief: ReliefOptions = field(default_factory=ReliefOptions)
    ground: GroundSetOptions = field(default_factory=GroundSetOptions)


def check_engines(options: Options, *, ground: bool = True) -> tuple[Path, ...]:
    """Whether the chosen engines can run, before an hour of work; those for ground photos only if there are any.

    Returns the files of weights that they will read.

    Raises:
        BackendUnavailable: a library, weights or a device are missing.
        InputError: nothing is where weights are said to be.
    """
    air = (options.reconstruct, options.labels, options.densify, options.model.ranking, options.match.dense)
    return files_of(*air, *(options.ground.engines if ground else ()))
