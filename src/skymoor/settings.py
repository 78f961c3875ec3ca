# SPDX-License-Identifier: Apache-2.0
"""Every option of every stage, by its dotted name: each stage owns its own, here they meet."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from skymoor.densify import DepthAnythingDepth, MarigoldDepth, SgmDepth
from skymoor.ground import GroundOptions, JointOptions
from skymoor.lift import LiftOptions
from skymoor.match import CyclicOptions, MatcherOptions, SearchOptions
from skymoor.model import MeshBuilder, NerfBuilder, SceneBuilder
from skymoor.orient import OrientOptions, UprightOptions
from skymoor.reconstruct import ReconstructOptions, ground_options
from skymoor.register import RegisterOptions, ReliefOptions
from skymoor.render import RenderOptions
from skymoor.tile_search import CascadeOptions, ConsensusOptions


@dataclass(frozen=True)
class MatchOptions:
    """From the nadir render to pixels of the reference.

    Attributes:
        min_height_m, max_height_m: flying heights that are searched: the scale of a levelled model.
        candidates: placements that are matched densely; the one with most independent inliers is believed.
        min_height_confidence: heights of the render below it are neither matched nor compared nor written.
        search, dense, cyclic: of the steps.
    """

    min_height_m: float = 20.0
    max_height_m: float = 200.0
    candidates: int = 3
    min_height_confidence: float = 0.2
    search: SearchOptions = field(default_factory=SearchOptions)
    dense: MatcherOptions = field(default_factory=MatcherOptions)
    cyclic: CyclicOptions = field(default_factory=CyclicOptions)


@dataclass(frozen=True)
class ModelOptions:
    """Which model of the airborne set is rendered.

    Attributes:
        kind: "mesh" for fused depth maps, which takes seconds; "nerf" for the radiance field, which takes minutes, is
            closer to the surface and knows better where it is not.
        monocular: engine whose depths of single photos rank the depths of the radiance field, where photos measure
            none: "none", "marigold" (the paper's) or "depth_anything" (lighter).
        nerf, mesh, marigold, depth_anything: how each is set up.
    """

    kind: Literal["mesh", "nerf"] = "mesh"
    monocular: Literal["none", "marigold", "depth_anything"] = "none"
    nerf: NerfBuilder = field(default_factory=NerfBuilder)
    mesh: MeshBuilder = field(default_factory=MeshBuilder)
    marigold: MarigoldDepth = field(default_factory=MarigoldDepth)
    depth_anything: DepthAnythingDepth = field(default_factory=DepthAnythingDepth)

    @property
    def builder(self) -> SceneBuilder:
        """The chosen one."""
        return self.nerf if self.kind == "nerf" else self.mesh

    @property
    def ranking(self) -> MarigoldDepth | DepthAnythingDepth | None:
        """What ranks depths; None where nothing does."""
        if self.kind != "nerf" or self.monocular == "none":
            return None
        return self.marigold if self.monocular == "marigold" else self.depth_anything


@dataclass(frozen=True)
class GroundSetOptions:
    """From ground photos to the airborne model.

    Attributes:
        reconstruct, densify: as for the airborne set, for photos of several lenses from nearby.
        upright: how up is found.
        method: how a component is laid on the airborne model. "walls" compares the walls of both models and needs no
            learned matcher; "cascade" and "exhaustive" match the photos with tiles of the airborne model's renders by
            `matcher`, few of the pairs or all as in the paper.
        place: of "walls"; every component's cameras are heard with it.
        matcher, cascade, exhaustive: of the other two.
        joint: when components contradict each other.
    """

    method: Literal["walls", "cascade", "exhaustive"] = "walls"
    reconstruct: ReconstructOptions = field(default_factory=ground_options)
    densify: SgmDepth = field(default_factory=SgmDepth)
    upright: UprightOptions = field(default_factory=UprightOptions)
    place: GroundOptions = field(default_factory=GroundOptions)
    matcher: MatcherOptions = field(default_factory=MatcherOptions)
    cascade: CascadeOptions = field(default_factory=CascadeOptions)
    exhaustive: ConsensusOptions = field(default_factory=ConsensusOptions)
    joint: JointOptions = field(default_factory=JointOptions)


@dataclass(frozen=True)
class Options:
    """Every option of every stage, by its dotted name."""

    reconstruct: ReconstructOptions = field(default_factory=ReconstructOptions)
    orient: OrientOptions = field(default_factory=OrientOptions)
    densify: SgmDepth = field(default_factory=SgmDepth)
    model: ModelOptions = field(default_factory=ModelOptions)
    render: RenderOptions = field(default_factory=RenderOptions)
    match: MatchOptions = field(default_factory=MatchOptions)
    lift: LiftOptions = field(default_factory=LiftOptions)
    register: RegisterOptions = field(default_factory=RegisterOptions)
    relief: ReliefOptions = field(default_factory=ReliefOptions)
    ground: GroundSetOptions = field(default_factory=GroundSetOptions)


def check_engines(options: Options) -> None:
    """Whether the chosen engines can run, before an hour of work.

    Raises:
        BackendUnavailable: a library or weights are missing.
        InputError: nothing is where weights are said to be.
    """
    options.match.dense.ready()
    if options.model.ranking is not None:
        options.model.ranking.ready()
    if options.ground.method != "walls":
        options.ground.matcher.ready()
