# SPDX-License-Identifier: Apache-2.0
"""Photos without metadata to reconstructions, every one of them kept (paper, section 3.1, structure from motion)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from shutil import disk_usage
from tempfile import TemporaryDirectory

import numpy as np
import pycolmap

from skymoor.engines.colmap import component_from_colmap, mean_colours
from skymoor.engines.options import files_of
from skymoor.errors import InputError
from skymoor.reconstruct._sift import SiftMatcher
from skymoor.reconstruct.calibration import adjust, calibrate
from skymoor.reconstruct.doppelgangers import ConflictFilter
from skymoor.reconstruct.graph import drop_pairs
from skymoor.reconstruct.protocol import PairFilter, PairMatcher, colmap_name
from skymoor.reconstruct.shared_intrinsics import (
    IntrinsicsOptions,
    group_intrinsics,
    shared_intrinsics,
    without_doubtful,
    without_impossible,
    write_intrinsics,
)
from skymoor.reconstruct.uncertainty import centre_covariances
from skymoor.types import Component, Photos, Progress, no_progress


@dataclass(frozen=True)
class ReconstructOptions:
    """How photos become components.

    Attributes:
        matcher: the engine that fills the database with verified matches.
        min_cameras: smaller components are dropped; the paper keeps those of nine.
        refine_principal_point: at the end, where the photos share one camera and fix its focal length.
        mixed_lenses: photos of one size may come from several cameras, and which photos share one is found out. The
            matcher should give each photo a camera of its own then.
        lens: when photos share a lens.
        min_inliers: correspondences with the model that a photo of known lens needs to join it, where lenses are mixed.
        pair_filter: the engine that finds pairs of photos of different places that look alike; None keeps all pairs.
    """

    matcher: PairMatcher = field(default_factory=SiftMatcher)
    min_cameras: int = 3
    refine_principal_point: bool = True
    mixed_lenses: bool = False
    lens: IntrinsicsOptions = field(default_factory=IntrinsicsOptions)
    min_inliers: int = 15
    pair_filter: PairFilter | None = None

    def ready(self) -> tuple[Path, ...]:
        """The files that the engines will read. Raises what they raise."""
        return files_of(self.matcher, self.pair_filter)


def ground_options() -> ReconstructOptions:
    """For photos from the ground, by several people and by security cameras."""
    matcher = SiftMatcher(shared_camera=False, exhaustive_below=60)
    return ReconstructOptions(matcher, mixed_lenses=True, pair_filter=ConflictFilter())


def reconstruct(
    photos: Photos,
    options: ReconstructOptions | None = None,
    *,
    seed: int = 0,
    progress: Progress = no_progress,
) -> list[Component]:
    """Structure from motion: all components, largest first, each in a frame of its own.

    Returns an empty list where no pair of photos has enough in common. Raises `InputError` when there is no room for
    temporary files.
    """
    options = options or ReconstructOptions()
    names = {colmap_name(i, photos.sizes[i]): photos.names[i] for i in range(len(photos))}
    pycolmap.set_random_seed(seed)
    with _temporary_folder() as folder:
        database = folder / "database.db"
        n = len(photos)
        options.matcher(photos, database, folder, seed=seed, progress=lambda done, of, _="": progress(3 * done, 4 * of))
        mapped = [0]

        def next_image() -> None:
            mapped[0] += 1
            progress(3 * n + min(n, mapped[0]), 4 * n)

        models = _map(database, folder, _mapping_options(options, seed), next_image)
        models = _improved(models, database, folder, photos, options, seed)
    components = [_finish(model, names, photos, options) for model in models]
    progress(4 * n, 4 * n)
    return components


@contextmanager
def _temporary_folder() -> Iterator[Path]:
    """For COLMAP's files: grey copies of all photos, and the database."""
    mend = "make room there for temporary files, or set TMPDIR to another folder"
    try:
        with TemporaryDirectory(prefix="skymoor-") as name:
            try:
                yield Path(name)
            except RuntimeError as error:  # COLMAP has no error of its own for a full disk, and not always SQLite's
                if "disk is full" in str(error) or disk_usage(name).free < 1 << 20:
                    raise InputError(f"{Path(name).parent}: no space left on device; {mend}") from error
                raise
    except OSError as error:
        raise InputError(f"{error.filename or 'temporary files'}: {error.strerror or error}; {mend}") from error


def _improved(
    models: list[pycolmap.Reconstruction],
    database: Path,
    folder: Path,
    photos: Photos,
    options: ReconstructOptions,
    seed: int,
) -> list[pycolmap.Reconstruction]:
    """Mapped again, once with the lenses that were found, and as long as pairs of look-alikes come to light."""
    names = {colmap_name(i, size): name for i, (name, size) in enumerate(zip(photos.names, photos.sizes, strict=True))}
    pair_filter = options.pair_filter
    rounds = 0 if pair_filter is None else pair_filter.rounds
    for round_ in range(rounds + 2):
        if options.mixed_lenses:
            models = [group_intrinsics(model, options.lens) for model in models]
        certain = _certain(models, options)
        mapping, changed = _mapping_options(options, seed), False
        with pycolmap.Database.open(database) as db:
            if pair_filter is not None and round_ < rounds:
                components = tuple(component_from_colmap(model, names) for model in certain)
                changed = drop_pairs(db, photos, components, pair_filter) > 0
            if options.mixed_lenses:
                mapping.constant_cameras = write_intrinsics(db, shared_intrinsics(models, options.lens))
                mapping.mapper.abs_pose_min_num_inliers = options.min_inliers
                changed = changed or round_ == 0
        if not changed:
            break
        models = _map(database, folder, mapping, lambda: None)
    return certain


def _certain(models: list[pycolmap.Reconstruction], options: ReconstructOptions) -> list[pycolmap.Reconstruction]:
    if not options.mixed_lenses:
        return models
    certain = [without_doubtful(model, options.lens) for model in models]
    return _worth_keeping([model for model in certain if model.num_reg_images() >= options.min_cameras])


def _map(
    database: Path, folder: Path, options: pycolmap.IncrementalPipelineOptions, report: Callable[[], None]
) -> list[pycolmap.Reconstruction]:
    models = pycolmap.incremental_mapping(database, folder, folder, options, next_image_callback=report)
    possible = [without_impossible(model) for model in models.values()]
    return _worth_keeping([model for model in possible if model.num_reg_images() >= options.min_model_size])


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
    component = component_from_colmap(model, names)
    component = replace(component, calibration=calibration, centre_covariances=centre_covariances(model, component))
    colours = np.clip(mean_colours(component, photos.read) + 0.5, 0, 255).astype(np.uint8)
    return replace(component, colours=colours)
