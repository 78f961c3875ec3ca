# SPDX-License-Identifier: Apache-2.0
"""Options of the radiance field: size, training, losses, prior and uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from skymoor.engines.options import FIXED
from skymoor.model.blend import BlendOptions


@dataclass(frozen=True)
class Sizes:
    """Size and training of a field; the defaults are for two CPU cores.

    Attributes:
        levels, features: number of levels of the hash encoding, and features per level.
        base_cells: cells of the coarsest level across the contracted site.
        finest_px: cell of the finest level, in pixels of the photos on the ground.
        table_log2, finest_table_log2: entries of a level, and of the finest one, as powers of two.
        hidden, geometry: width of the density network, and the number of its outputs for the colour network.
        colour_hidden: width of the colour network.
        appearance: length of a photo's appearance vector; 0 uses three gains per photo instead.
        view_direction: whether colour depends on the viewing direction.
        exact_backward: gradients to all eight corners of a cell, not to a random one.
        rays, samples: rays per training step, and samples per ray.
        bins: samples of the proposal along a ray.
        render_samples, refine_samples: samples per ray in the first pass of a render, and in the following ones.
        iterations: training steps at most.
        passes: training also ends when each pixel has been used this many times on average.
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
            raise ValueError("sizes of a field must be positive, with at least 3 features, 2 samples and 4 bins")


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
    """Weights of the losses, 0 to switch one off; see `losses`.

    Attributes:
        photometric: difference of colours.
        depth: termination distribution against a measured depth.
        line_of_sight: termination in front of a measured depth.
        distortion: spread of the termination along a ray.
        opacity: transmittance through the ground.
        ranking: depth order of pairs of pixels against monocular depths.
        depth_sigma_px: lower bound of the standard deviation of a measured depth, in pixels on the ground.
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
            raise ValueError("the weights of losses must not be negative")


@dataclass(frozen=True)
class PriorOptions:
    """The prior on density from depth maps.

    Attributes:
        cell_px: edge of a cell, in pixels of the photos on the ground.
        max_cells_across: largest number of cells along the site's side; bounds memory.
        band_cells: half width of the band around a measured depth, in cells.
        slope: growth of the logarithm of density per cell at a surface.
        unknown, free: logarithms of density, on top of the field's own, in unknown and in free space.
        max_sigma_ratio: depths of a larger relative standard deviation are not used.
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
    """Estimation of uncertainty, and its effect on the confidence.

    Attributes:
        rays: pixels that are used; 0 omits Bayes' Rays.
        cells_across: vertices of the deformation across the contracted site.
        widest_px: prior standard deviation of the deformation, in pixels on the ground.
        spread_px, bayes_px: standard deviations of depth along a ray, and by Bayes' Rays, that halve the confidence,
            in pixels on the ground.
    """

    rays: int = 65536
    cells_across: int = 96
    widest_px: float = 20.0
    spread_px: float = 3.0
    bayes_px: float = 4.0


@dataclass(frozen=True)
class NerfOptions:
    """A radiance field supervised by depth maps.

    Attributes:
        preset: `small` for a few CPU cores or `huge` for a GPU.
        small, huge: sizes of the presets.
        iterations: training steps at most; 0 for those of the preset.
        budget_s: limit of the training time in seconds; 0 for none. A training that time ends is not reproducible bit
            by bit.
        device: `auto` uses CUDA where available.
        threads: of PyTorch on a CPU; 0 for its default.
        seed: of all random numbers.
        compile: compile the encoding; needs a C++ compiler and some seconds, and is skipped without one.
        texture: source of the colours of renders: the photos ("blend"), the field, or that of the preset.
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
        """The sizes of the preset, with `iterations` if given."""
        sizes = self.small if self.preset == "small" else self.huge
        return replace(sizes, iterations=self.iterations) if self.iterations else sizes

    @property
    def colours(self) -> Literal["blend", "field"]:
        """Source of the colours of renders."""
        if self.texture == "auto":
            return "blend" if self.preset == "small" else "field"
        return self.texture
