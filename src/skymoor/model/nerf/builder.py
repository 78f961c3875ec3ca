# SPDX-License-Identifier: Apache-2.0
"""What builds a radiance field. PyTorch is loaded when it is called."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from skymoor.engines.libraries import require
from skymoor.model.nerf.options import NerfOptions
from skymoor.model.protocol import SceneBuilder
from skymoor.types import Array32, Component, DepthMap, Progress, no_progress

if TYPE_CHECKING:
    from skymoor.model.nerf.model import NerfModel


@dataclass(frozen=True)
class NerfBuilder(NerfOptions):
    """Builds a `NerfModel`: a radiance field that is supervised by depth maps."""

    def ready(self) -> tuple[Path, ...]:
        """No files are read; raises `BackendUnavailable` where PyTorch is missing."""
        require("torch", "nerf")
        return ()

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
            BackendUnavailable: PyTorch is missing, or CUDA is asked for and missing.
        """
        from skymoor.model.nerf.build import build_model

        return build_model(self, depths, progress, monocular, report, checkpoint)


_builder: type[SceneBuilder] = NerfBuilder
