# SPDX-License-Identifier: Apache-2.0
"""How large a radiance field is, how it is trained, and what its losses weigh."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from skymoor.engines.options import FIXED
from skymoor.model.blend import BlendOptions


@dataclass(frozen=True)
class Sizes:
    """One preset. The defaults are for two CPU cores.

    Attributes:
        levels, features: of the hash encoding.
        base_cells: cells of the coarsest level across the contracted site.
        finest_px: cell of the finest level, in pixels of the photos on the ground.
        table_log2, finest_table_log2: entries of a level, and of the finest one, as powers of two.
        hidden, geometry: width of the density network, and how many values it hands to the colour network.
        colour_hidden: width of the colour network.
        appearance: length of a photo's appearance vector; 0 gives each photo three gains instead.
        view_direction: whether colour depends on the direction of sight.
        exact_backward: gradients to all eight corners of a cell, not to one drawn at random.
        rays, samples: of a training step.
        bins: places along a ray at which the proposal is looked up.
        render_samples, refine_samples: per ray of the first pass of a render, and of the following ones.
        iterations: training steps at most.
        passes: training also ends when each pixel has been looked at so many times on average.
        table_rate, mlp_rate: learning rates of the encoding and of the networks.
    """

    levels: int = 8
    features: int = 4
    base_cells: int = 32
    finest_px: float = 1.25
    table_log2: int = 19
    finest_table_log2: int = 21
    hidden: int = 64
    geometry: int = 15
    colour_hidden: int = 64
    appearance: int = 0
    view_direction: bool = False
    exact_backward: bool = False
    rays: int = 4096
    samples: int = 8
    bins: int = 64
    render_samples: int = 12
    refine_samples: int = 6
    iterations: int = 600
    passes: float = 0.5
    table_rate: float = 3e-2
    mlp_rate: float = 4e-3

    def __post_init__(self) -> None:
        counts = (self.levels, self.base_cells, self.rays, self.iterations, self.hidden, self.colour_hidden)
        if min(counts) < 1 or self.passes <= 0 or self.features < 3 or self.samples < 2 or self.bins < 4:
            raise ValueError("sizes of a field are positive, with 3 features, 2 samples and 4 bins at least")


HUGE = Sizes(
    levels=16,
    base_cells=16,
    finest_px=0.5,
    table_log2=21,
    finest_table_log2=22,
    features=4,
    hidden=256,
    colour_hidden=256,
    appearance=32,
    view_direction=True,
    exact_backward=True,
    rays=16384,
    samples=64,
    bins=256,
    render_samples=64,
    refine_samples=16,
    iterations=30000,
    passes=30.0,
    table_rate=1e-2,
    mlp_rate=2e-3,
)


@dataclass(frozen=True)
class LossWeights:
    """What each loss weighs; 0 switches it off. See `losses` for what they are.

    Attributes:
        photometric: of the difference of colours.
        depth: of the distribution of weight around a measured depth.
        line_of_sight: of weight before a measured depth.
        distortion: of weight that is spread along a ray.
        opacity: of light that comes through the ground.
        ranking: of pairs of pixels whose order in depth contradicts a monocular depth.
        depth_sigma_px: least standard deviation of a measured depth, in pixels on the ground.
    """

    photometric: float = 1.0
    depth: float = 0.2
    line_of_sight: float = 0.4
    distortion: float = 0.02
    opacity: float = 0.05
    ranking: float = 0.1
    depth_sigma_px: float = 0.5

    def __post_init__(self) -> None:
        if min(vars(self).values()) < 0:
            raise ValueError("weights of losses are not negative")


@dataclass(frozen=True)
class PriorOptions:
    """How depth maps become a prior on density.

    Attributes:
        cell_px: edge of a cell, in pixels of the photos on the ground.
        max_cells_across: bounds the memory for very large sites.
        band_cells: a depth speaks about the surface so many cells before and behind it.
        slope: by how much the logarithm of density grows per cell at a surface.
        unknown, free: logarithms of density, on top of the field's own, where nothing is known and in the air.
        max_sigma_ratio: depths less certain than this share of themselves do not count.
    """

    cell_px: float = 2.0
    max_cells_across: int = 640
    band_cells: float = 2.5
    slope: float = 4.0
    unknown: float = -2.0
    free: float = -5.0
    max_sigma_ratio: float = 0.02


@dataclass(frozen=True)
class UncertaintyOptions:
    """How uncertainty is estimated, and what it costs in confidence.

    Attributes:
        rays: pixels that are asked; 0 leaves Bayes' Rays out.
        cells_across: vertices of the deformation across the contracted site.
        widest_px: standard deviation of the deformation before any photo is asked, in pixels on the ground.
        spread_px, bayes_px: a standard deviation of depth along a ray, and one by Bayes' Rays, that halve the
            confidence, in pixels on the ground.
    """

    rays: int = 65536
    cells_across: int = 96
    widest_px: float = 20.0
    spread_px: float = 3.0
    bayes_px: float = 4.0


@dataclass(frozen=True)
class NerfOptions:
    """How a radiance field that is supervised by depth maps is built.

    Attributes:
        preset: which sizes are taken, `small` for a few CPU cores or `huge` for a GPU.
        small, huge: those sizes.
        iterations: training steps at most; 0 leaves them to the preset.
        budget_s: seconds of training on the clock; 0 leaves it to the preset's number of steps. What the clock ends
            cannot be repeated to the bit.
        device: `auto` takes CUDA where there is one.
        threads: of PyTorch on a CPU; 0 leaves its own choice.
        seed: of everything random.
        compile: compile the encoding; takes seconds and a C++ compiler, and is left out silently without one.
        texture: whose colours renders show: of the photos ("blend"), of the field, or as the preset has it.
        losses, prior, blend, uncertainty: of the parts.
    """

    preset: Literal["small", "huge"] = "small"
    small: Sizes = field(default_factory=Sizes, metadata=FIXED)
    huge: Sizes = field(default=HUGE, metadata=FIXED)
    iterations: int = 0
    budget_s: float = 0.0
    device: Literal["auto", "cpu", "cuda"] = field(default="auto", metadata=FIXED)
    threads: int = 0
    seed: int = field(default=0, metadata=FIXED)
    compile: bool = False
    texture: Literal["auto", "blend", "field"] = "auto"
    losses: LossWeights = field(default_factory=LossWeights, metadata=FIXED)
    prior: PriorOptions = field(default_factory=PriorOptions, metadata=FIXED)
    blend: BlendOptions = field(default_factory=BlendOptions, metadata=FIXED)
    uncertainty: UncertaintyOptions = field(default_factory=UncertaintyOptions, metadata=FIXED)

    @property
    def sizes(self) -> Sizes:
        """Those of the preset."""
        sizes = self.small if self.preset == "small" else self.huge
        return replace(sizes, iterations=self.iterations) if self.iterations else sizes

    @property
    def colours(self) -> Literal["blend", "field"]:
        """Whose colours renders show."""
        if self.texture == "auto":
            return "blend" if self.preset == "small" else "field"
        return self.texture
