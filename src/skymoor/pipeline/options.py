# SPDX-License-Identifier: Apache-2.0
"""Every option by its dotted name. What no user can sensibly set is a constant where it is used, with its source."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from skymoor.engines.options import files_of
from skymoor.ground.plan_view import OnMapOptions
from skymoor.ground.tiles import CascadeOptions
from skymoor.ground.walls import GroundOptions
from skymoor.match import CyclicOptions, DecoyOptions, DenseMatcher, PointMatcher, SearchOptions
from skymoor.model import MeshBuilder, NerfBuilder, RenderOptions, SceneBuilder
from skymoor.pipeline.engines import (
    DenseMatcherName,
    Engines,
    LabelerName,
    MetricDepthName,
    PairFilterName,
    PairMatcherName,
    PointMatcherName,
    RelativeDepthName,
    RetrieverName,
    StereoName,
)
from skymoor.reconstruct import ReconstructOptions
from skymoor.registration import LiftOptions, RegisterOptions
from skymoor.store import VideoOptions


@dataclass(frozen=True)
class ReconstructChoices:
    """How photos become components.

    Attributes:
        matcher: "sift" needs no weights; "aliked" is a learned one for CPUs; "dedode_roma" is the paper's, for GPUs;
            "colmap_aliked" is COLMAP's own, for builds of it with ONNX.
        pair_filter: "none" keeps all pairs; "conflicts" compares what cameras ought to share in a first reconstruction;
            "doppelgangers" is the paper's network.
        exhaustive_below: sets of fewer photos are matched all with all.
        min_cameras: smaller components are dropped; the paper keeps those of nine.
        refine_principal_point: at the end, where the photos share one camera and fix its focal length.
        mixed_lenses: ground photos of one size may come from several cameras, and which share one is found out;
            lenses of airborne photos are always told apart.
    """

    matcher: PairMatcherName = "sift"
    pair_filter: PairFilterName = "none"
    exhaustive_below: int = 40
    min_cameras: int = 3
    refine_principal_point: bool = True
    mixed_lenses: bool = False

    def stage_options(self, engines: Engines, *, shared_camera: bool) -> ReconstructOptions:
        """The same with the engines themselves."""
        return ReconstructOptions(
            matcher=engines.pair_matcher(
                self.matcher, shared_camera=shared_camera, exhaustive_below=self.exhaustive_below
            ),
            min_cameras=self.min_cameras,
            refine_principal_point=self.refine_principal_point,
            mixed_lenses=self.mixed_lenses,
            pair_filter=engines.pair_filter(self.pair_filter),
        )


@dataclass(frozen=True)
class OrientChoices:
    """How up is found.

    Attributes:
        labels: which network says where the ground is: "none" leaves it to geometry, "oneformer" is the paper's,
            "semantic" a lighter one.
    """

    labels: LabelerName = "none"


@dataclass(frozen=True)
class DensifyChoices:
    """How depth is measured.

    Attributes:
        method: "sgm" runs on a CPU; "patchmatch", the paper's, needs a COLMAP with CUDA.
    """

    method: StereoName = "sgm"


@dataclass(frozen=True)
class ModelOptions:
    """Which model of the airborne set is rendered.

    Attributes:
        kind: "mesh" for fused depth maps, which takes seconds; "nerf" for the radiance field, which takes minutes, is
            closer to the surface and knows better where it is not.
        ranking: whose depths of single photos rank the depths of the radiance field, where photos measure none:
            "marigold" is the paper's, "depth_anything" is lighter.
        nerf, mesh: how each is set up.
    """

    kind: Literal["mesh", "nerf"] = "mesh"
    ranking: RelativeDepthName = "none"
    nerf: NerfBuilder = field(default_factory=NerfBuilder)
    mesh: MeshBuilder = field(default_factory=MeshBuilder)

    def builder(self, engines: Engines) -> SceneBuilder:
        """The chosen one."""
        return replace(self.nerf, device=engines.device) if self.kind == "nerf" else self.mesh


@dataclass(frozen=True)
class MatchOptions:
    """From the nadir render to pixels of the reference.

    Attributes:
        min_height_m, max_height_m: flying heights that are searched: the scale of a levelled model.
        candidates: hypotheses that are matched densely; the one with most independent inliers is taken.
        min_height_confidence: heights of the render below it are neither matched nor compared nor written.
        matcher: "structural" needs no weights; the others do, and libraries.
        search, decoys, cyclic: of the steps.
    """

    min_height_m: float = 20.0
    max_height_m: float = 200.0
    candidates: int = 3
    min_height_confidence: float = 0.2
    matcher: DenseMatcherName = "structural"
    search: SearchOptions = field(default_factory=SearchOptions)
    decoys: DecoyOptions = field(default_factory=DecoyOptions)
    cyclic: CyclicOptions = field(default_factory=CyclicOptions)


def _of_ground() -> ReconstructChoices:
    return ReconstructChoices(pair_filter="conflicts", exhaustive_below=60, mixed_lenses=True)


@dataclass(frozen=True)
class GroundChoices:
    """From ground photos to the airborne model.

    Attributes:
        method: how a component is registered. "walls" compares the walls of both models and needs no learned matcher;
            "cascade" and "exhaustive" match the photos with tiles of the airborne model's renders by `matcher`, few of
            the pairs or all as in the paper.
        matcher, retriever: of "cascade" and "exhaustive"; "anyloc" is the paper's retriever.
        key_points: of "walls": what else compares walls, to order places; "auto" takes XFeat where its weights lie on
            disk (`skymoor weights fetch xfeat`).
        labels: which network says where the ground is; the cameras' height above it is the unit of the search.
        metric: which network says how many metres that is, so that less has to be searched.
        densify: dense stereo of ground photos.
        reconstruct: as for the airborne set, for photos of several lenses from nearby.
        walls, cascade: of the methods.
        on_map: where there are no airborne photos.
    """

    method: Literal["walls", "cascade", "exhaustive"] = "walls"
    matcher: DenseMatcherName = "structural"
    retriever: RetrieverName = "channels"
    key_points: PointMatcherName = "auto"
    labels: LabelerName = "none"
    metric: MetricDepthName = "none"
    densify: StereoName = "sgm"
    reconstruct: ReconstructChoices = field(default_factory=_of_ground)
    walls: GroundOptions = field(default_factory=GroundOptions)
    cascade: CascadeOptions = field(default_factory=CascadeOptions)
    on_map: OnMapOptions = field(default_factory=OnMapOptions)

    def dense_matcher(self, engines: Engines) -> DenseMatcher | None:
        """What matches photos with tiles; None for "walls"."""
        return None if self.method == "walls" else engines.dense_matcher(self.matcher)

    def point_matcher(self, engines: Engines) -> PointMatcher | None:
        """What matches key points of walls; None for other methods, and where there is none."""
        return engines.point_matcher(self.key_points) if self.method == "walls" else None


@dataclass(frozen=True)
class Options:
    """Every option of every stage, by its dotted name."""

    engines: Engines = field(default_factory=Engines)
    video: VideoOptions = field(default_factory=VideoOptions)
    reconstruct: ReconstructChoices = field(default_factory=ReconstructChoices)
    orient: OrientChoices = field(default_factory=OrientChoices)
    densify: DensifyChoices = field(default_factory=DensifyChoices)
    model: ModelOptions = field(default_factory=ModelOptions)
    render: RenderOptions = field(default_factory=RenderOptions)
    match: MatchOptions = field(default_factory=MatchOptions)
    lift: LiftOptions = field(default_factory=LiftOptions)
    register: RegisterOptions = field(default_factory=RegisterOptions)
    ground: GroundChoices = field(default_factory=GroundChoices)


def check_engines(options: Options, *, ground: bool = True) -> tuple[Path, ...]:
    """Whether the chosen engines can run, before an hour of work; those for ground photos only if there are any.

    Returns the files of weights that they will read.

    Raises:
        BackendUnavailable: a library, weights or a device are missing.
        InputError: nothing is where weights are said to be, or a number is out of its range.
    """
    options.video.check()
    engines, model, chosen = options.engines, options.model, options.ground
    air = (
        options.reconstruct.stage_options(engines, shared_camera=True),
        engines.labeler(options.orient.labels),
        engines.stereo(options.densify.method),
        model.builder(engines),
        engines.relative_depth(model.ranking) if model.kind == "nerf" else None,
        engines.dense_matcher(options.match.matcher),
    )
    if not ground:
        return files_of(*air)
    return files_of(
        *air,
        chosen.reconstruct.stage_options(engines, shared_camera=False),
        engines.stereo(chosen.densify),
        engines.labeler(chosen.labels),
        engines.metric_scale(chosen.metric),
        chosen.dense_matcher(engines),
        chosen.point_matcher(engines),
        engines.retriever(chosen.retriever) if chosen.method == "cascade" else None,
    )
