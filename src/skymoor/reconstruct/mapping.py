# SPDX-License-Identifier: Apache-2.0
"""Photos without metadata to reconstructions, every one of them kept (paper, section 3.1, structure from motion)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pycolmap

from skymoor.colmap import component_from_colmap, mean_colours
from skymoor.reconstruct._sift import SiftMatcher
from skymoor.reconstruct.calibration import adjust, calibrate
from skymoor.reconstruct.protocol import PairMatcher, colmap_name
from skymoor.types import Component, Photos, Progress, no_progress


@dataclass(frozen=True)
class ReconstructOptions:
    """How photos become components.

    Attributes:
        matcher: the engine that fills the database with verified matches.
        min_cameras: smaller components are dropped.
        refine_principal_point: at the end, where the photos share one camera and fix its focal length.
    """

    matcher: PairMatcher = field(default_factory=SiftMatcher)
    min_cameras: int = 3
    refine_principal_point: bool = True


def reconstruct(
    photos: Photos,
    options: ReconstructOptions | None = None,
    *,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Component]:
    """Structure from motion: all components, largest first, each in a frame of its own.

    Returns an empty list where no pair of photos has enough in common.
    """
    options = options or ReconstructOptions()
    names = {colmap_name(i, photos.sizes[i]): photos.names[i] for i in range(len(photos))}
    pycolmap.set_random_seed(seed)
    with TemporaryDirectory(prefix="skymoor-") as temporary:
        folder = Path(temporary)
        database = folder / "database.db"
        n = len(photos)
        options.matcher(photos, database, folder, seed=seed, progress=lambda done, of, _="": progress(3 * done, 4 * of))
        mapped = [0]

        def next_image() -> None:
            mapped[0] += 1
            progress(3 * n + min(n, mapped[0]), 4 * n)

        models = pycolmap.incremental_mapping(
            database, folder, folder, _mapping_options(options, seed), next_image_callback=next_image
        )
    components = [_finish(model, names, photos, options) for model in _worth_keeping(list(models.values()))]
    progress(4 * n, 4 * n)
    return components


def _worth_keeping(models: list[pycolmap.Reconstruction]) -> list[pycolmap.Reconstruction]:
    """Largest first, without those whose photos are all in larger ones: COLMAP lets models overlap."""
    known: set[int] = set()
    kept = []
    for model in sorted(models, key=lambda model: -model.num_reg_images()):
        images = set(model.reg_image_ids())
        if not images <= known:
            kept.append(model)
        known |= images
    return kept


def _mapping_options(options: ReconstructOptions, seed: int) -> pycolmap.IncrementalPipelineOptions:
    mapping = pycolmap.IncrementalPipelineOptions(
        min_model_size=options.min_cameras,
        extract_colors=False,
        # Several threads race for the first pair, and the winner decides the frame: not repeatable.
        num_threads=1,
        random_seed=seed,
    )
    mapping.mapper.random_seed = seed
    mapping.triangulation.random_seed = seed
    return mapping


def _finish(
    model: pycolmap.Reconstruction, names: dict[str, str], photos: Photos, options: ReconstructOptions
) -> Component:
    """Last adjustment, calibration report and colours."""
    adjust(model)
    calibration = calibrate(model)
    # A principal point is one more thing that a weak block cannot tell: there it would trade against tilt and height.
    if calibration.shared_intrinsics and not calibration.uncertain and options.refine_principal_point:
        adjust(model, principal_point=True)
        calibration = calibrate(model)
    component = replace(component_from_colmap(model, names), calibration=calibration)
    colours = np.clip(mean_colours(component, photos.read) + 0.5, 0, 255).astype(np.uint8)
    return replace(component, colours=colours)
