# SPDX-License-Identifier: Apache-2.0
"""Builder of radiance fields; PyTorch is imported on the first call."""

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
    """Builds a `NerfModel`: a radiance field supervised by photos and depth maps."""

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
            component: the levelled reconstruction to which the depth maps belong.
            depths: depth maps with overlapping coverage, at least two.
            progress: called with the progress of training in thousandths.
            monocular: relative depths (h, w) of the photos of `depths`, larger is farther, None where there is none.
            report: called periodically with step, psnr_db, depth_error (level units) and left_s.
            checkpoint: file from which interrupted training resumes; it is removed at the end.

        Raises:
            DegenerateGeometry: the depth maps have no common surface, or the training diverged.
            BackendUnavailable: PyTorch is missing, or CUDA is requested and missing.
        """
        from skymoor.model.nerf.build import build_model

        return build_model(self, depths, progress, monocular, report, checkpoint)


_builder: type[SceneBuilder] = NerfBuilder
