# SPDX-License-Identifier: Apache-2.0
"""What builds a radiance field, and all its options. PyTorch is loaded when it is called."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from skymoor.model.blend import BlendOptions
from skymoor.model.nerf.options import HUGE, LossWeights, PriorOptions, Sizes, UncertaintyOptions
from skymoor.model.protocol import SceneBuilder
from skymoor.types import Array32, Component, DepthMap, Progress, no_progress

if TYPE_CHECKING:
    from skymoor.model.nerf.model import NerfModel


@dataclass(frozen=True)
class NerfBuilder:
    """Builds a `NerfModel`: a radiance field that is supervised by depth maps.

    Attributes:
        preset: which sizes are taken, `small` for a few CPU cores or `huge` for a GPU.
        small, huge: those sizes.
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
    small: Sizes = field(default_factory=Sizes)
    huge: Sizes = HUGE
    budget_s: float = 0.0
    device: Literal["auto", "cpu", "cuda"] = "auto"
    threads: int = 0
    seed: int = 0
    compile: bool = False
    texture: Literal["auto", "blend", "field"] = "auto"
    losses: LossWeights = field(default_factory=LossWeights)
    prior: PriorOptions = field(default_factory=PriorOptions)
    blend: BlendOptions = field(default_factory=BlendOptions)
    uncertainty: UncertaintyOptions = field(default_factory=UncertaintyOptions)

    @property
    def sizes(self) -> Sizes:
        """Those of the preset."""
        return self.small if self.preset == "small" else self.huge

    @property
    def colours(self) -> Literal["blend", "field"]:
        """Whose colours renders show."""
        if self.texture == "auto":
            return "blend" if self.preset == "small" else "field"
        return self.texture

    def __call__(
        self,
        component: Component,
        depths: Sequence[DepthMap],
        *,
        progress: Progress = no_progress,
        monocular: Sequence[Array32 | None] | None = None,
        report: Callable[[Mapping[str, float]], None] | None = None,
        checkpoint: Path | None = None,
    ) -> NerfModel:
        """Train; see `SceneBuilder`.

        Args:
            component: the levelled reconstruction that the depth maps are of.
            depths: at least a few that see the same ground.
            progress: called with thousandths of the training.
            monocular: relative depths (h, w) of the photos of `depths`, larger is farther, None where there is none.
            report: told now and then of step, psnr_db, depth_error (level units) and left_s.
            checkpoint: file to keep an unfinished training in, and to take it up from; it is removed at the end.

        Raises:
            DegenerateGeometry: the depth maps hold no common surface, or the training diverged.
            BackendUnavailable: CUDA is asked for and missing.
        """
        from skymoor.model.nerf.build import build_model

        return build_model(self, depths, progress, monocular, report, checkpoint)


_builder: type[SceneBuilder] = NerfBuilder
