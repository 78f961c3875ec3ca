# SPDX-License-Identifier: Apache-2.0
"""Structure from motion of photos without metadata; all components are kept (paper, section 3.1)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from shutil import disk_usage

import numpy as np
import pycolmap

from skymoor.engines.colmap import STOP, component_from_colmap, mean_colours
from skymoor.engines.options import files_of
from skymoor.engines.temporary import temporary_folder
from skymoor.errors import InputError
from skymoor.reconstruct._sift import SiftMatcher
from skymoor.reconstruct.calibration import adjust, calibrate, widened
from skymoor.reconstruct.doppelgangers import ConflictFilter
from skymoor.reconstruct.graph import drop_pairs, view_graph
from skymoor.reconstruct.lens_groups import copy_with_cameras, scale_groups
from skymoor.reconstruct.lenses import HEIGHT_SPREAD, Lens, is_own, tie_focal_lengths
from skymoor.reconstruct.parts import parts_of
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

FREQUENT_ADJUSTMENT_BELOW, RARER_ADJUSTMENT = 100, 1.3
"""Photos beyond which everything is adjusted when a model has grown by 1.3, and not by COLMAP's 1.1: as exact in two
thirds of the time (docs/decisions/0032)."""


@dataclass(frozen=True)
class ReconstructOptions:
    """Options of structure from motion.

    Attributes:
        matcher: the engine that fills the database with verified matches.
        min_cameras: smaller components are dropped; the paper keeps those of nine.
        refine_principal_point: at the end, where the photos share one camera and determine its focal length.
        mixed_lenses: photos of one size may come from several cameras; the groups with shared intrinsics are
            estimated. The matcher should give each photo its own camera then.
        intrinsics: when photos share intrinsics.
        min_inliers: correspondences with the model that a photo of known intrinsics needs to be registered, with
            `mixed_lenses`.
        pair_filter: the engine that finds pairs of photos of different places that look alike; None keeps all pairs.
    """

    matcher: PairMatcher = field(default_factory=SiftMatcher)
    min_cameras: int = 3
    refine_principal_point: bool = True
    mixed_lenses: bool = False
    intrinsics: IntrinsicsOptions = field(default_factory=IntrinsicsOptions)
    min_inliers: int = 15
    pair_filter: PairFilter | None = None

    def ready(self) -> tuple[Path, ...]:
        """The files that the engines will read. Raises as they do."""
        return files_of(self.matcher, self.pair_filter)


def ground_options() -> ReconstructOptions:
    """Options for ground photos of several phones and security cameras."""
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

    Returns an empty list where no pair of photos has enough matches. Raises `InputError` when there is no space for
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

        models = _map(database, folder, _mapping_options(options, len(photos), seed), next_image)
        lenses: list[Lens] = []
        if not options.mixed_lenses:
            models, database, lenses = _told_apart(models, database, folder, photos, options, seed)
        models = _improved(models, database, folder, photos, options, seed)
    parts = [part for model in models for part in parts_of(model, options.min_cameras)]
    finished = [_adjusted(part, lenses) for part in sorted(parts, key=lambda part: -part.num_reg_images())]
    components = [
        _finish(model, names, photos, options, fixed)
        for model, fixed in finished
        if model.num_reg_images() >= options.min_cameras
    ]
    progress(4 * n, 4 * n)
    return components


@contextmanager
def _temporary_folder() -> Iterator[Path]:
    """A folder for COLMAP's files: copies of a few photos at a time, and the database."""
    remedy = "make room there for temporary files, or set TMPDIR to another folder"
    try:
        with temporary_folder() as folder:
            try:
                yield folder
            except RuntimeError as error:  # COLMAP has no error for a full disk, and not always SQLite's
                if "disk is full" in str(error) or disk_usage(folder).free < 1 << 20:
                    raise InputError(f"{folder.parent}: no space left on device; {remedy}") from error
                if _files_are_limited():
                    raise InputError(
                        f"{folder.parent}: a file would grow beyond its limit (ulimit -f); raise it"
                    ) from error
                raise
    except OSError as error:
        raise InputError(f"{error.filename or 'temporary files'}: {error.strerror or error}; {remedy}") from error


def _files_are_limited() -> bool:
    """Whether no file may grow beyond a size: COLMAP has no error for that either."""
    if sys.platform == "win32":
        return False
    import resource

    return resource.getrlimit(resource.RLIMIT_FSIZE)[0] != resource.RLIM_INFINITY


def _told_apart(
    models: list[pycolmap.Reconstruction],
    database: Path,
    folder: Path,
    photos: Photos,
    options: ReconstructOptions,
    seed: int,
) -> tuple[list[pycolmap.Reconstruction], Path, list[Lens]]:
    """Models, database and lenses, where photos of one size were taken through several; else as they were."""
    with pycolmap.Database.open(database) as db:
        groups = scale_groups(view_graph(db, photos, ()))
    if not groups:
        return models, database, []
    copy = folder / "lenses.db"
    lenses = copy_with_cameras(database, copy, photos, groups)
    apart = _map(copy, folder, _mapping_options(options, len(photos), seed), lambda: None)
    if not apart or not (own := [lens for lens in lenses if is_own(apart[0], lens)]):
        return models, database, []
    return apart, copy, own


def _improved(
    models: list[pycolmap.Reconstruction],
    database: Path,
    folder: Path,
    photos: Photos,
    options: ReconstructOptions,
    seed: int,
) -> list[pycolmap.Reconstruction]:
    """Map again, once with the shared intrinsics, and as long as the filter drops look-alike pairs."""
    names = {colmap_name(i, size): name for i, (name, size) in enumerate(zip(photos.names, photos.sizes, strict=True))}
    pair_filter = options.pair_filter
    rounds = 0 if pair_filter is None else pair_filter.rounds
    for round_ in range(rounds + 2):
        if options.mixed_lenses:
            models = [group_intrinsics(model, options.intrinsics) for model in models]
        reliable = _reliable(models, options)
        mapping, changed = _mapping_options(options, len(photos), seed), False
        with pycolmap.Database.open(database) as db:
            if pair_filter is not None and round_ < rounds:
                components = tuple(component_from_colmap(model, names) for model in reliable)
                changed = drop_pairs(db, photos, components, pair_filter) > 0
            if options.mixed_lenses:
                mapping.constant_cameras = write_intrinsics(db, shared_intrinsics(models, options.intrinsics))
                mapping.mapper.abs_pose_min_num_inliers = options.min_inliers
                changed = changed or round_ == 0
        if not changed:
            break
        models = _map(database, folder, mapping, lambda: None)
    return reliable


def _reliable(models: list[pycolmap.Reconstruction], options: ReconstructOptions) -> list[pycolmap.Reconstruction]:
    if not options.mixed_lenses:
        return models
    reliable = [without_doubtful(model, options.intrinsics) for model in models]
    return _distinct([model for model in reliable if model.num_reg_images() >= options.min_cameras])


def _map(
    database: Path, folder: Path, options: pycolmap.IncrementalPipelineOptions, report: Callable[[], None]
) -> list[pycolmap.Reconstruction]:
    models = pycolmap.incremental_mapping(
        database, folder, folder, options, next_image_callback=report, cancellation_token=STOP
    )
    possible = [without_impossible(model) for model in models.values()]
    return _distinct([model for model in possible if model.num_reg_images() >= options.min_model_size])


def _distinct(models: list[pycolmap.Reconstruction]) -> list[pycolmap.Reconstruction]:
    """Largest first, without those whose photos are all in larger ones: COLMAP lets models overlap."""
    covered: set[int] = set()
    kept = []
    for model in sorted(models, key=lambda model: -model.num_reg_images()):
        images = set(model.reg_image_ids())
        if not images <= covered:
            kept.append(model)
        covered |= images
    return kept


def _mapping_options(options: ReconstructOptions, photos: int, seed: int) -> pycolmap.IncrementalPipelineOptions:
    mapping = pycolmap.IncrementalPipelineOptions(
        min_model_size=options.min_cameras,
        extract_colors=False,
        # With several threads the initial pair, and so the frame, is not reproducible.
        num_threads=1,
        random_seed=seed,
    )
    if photos > FREQUENT_ADJUSTMENT_BELOW:
        mapping.ba_global_frames_ratio = mapping.ba_global_points_ratio = RARER_ADJUSTMENT
    mapping.mapper.random_seed = seed
    mapping.triangulation.random_seed = seed
    return mapping


def _adjusted(model: pycolmap.Reconstruction, lenses: Sequence[Lens]) -> tuple[pycolmap.Reconstruction, list[int]]:
    """The model after its last adjustment, without photos that it diverges for, and the cameras whose focal lengths
    are fixed.
    """
    fixed = tie_focal_lengths(model, lenses)
    while True:
        adjust(model, fixed=fixed)
        possible = without_impossible(model)
        if possible.num_reg_images() in (0, model.num_reg_images()):
            return possible, fixed
        model = possible


def _finish(
    model: pycolmap.Reconstruction,
    names: dict[str, str],
    photos: Photos,
    options: ReconstructOptions,
    fixed: Sequence[int],
) -> Component:
    """Calibration report and colours."""
    calibration = calibrate(model)
    if fixed:
        calibration = widened(calibration, HEIGHT_SPREAD)
    # In a weak block the principal point is correlated with tilt and height.
    if calibration.shared_intrinsics and not calibration.uncertain and options.refine_principal_point:
        adjust(model, principal_point=True)
        calibration = calibrate(model)
    component = component_from_colmap(model, names)
    component = replace(component, calibration=calibration, centre_covariances=centre_covariances(model, component))
    colours = np.clip(mean_colours(component, photos.read) + 0.5, 0, 255).astype(np.uint8)
    return replace(component, colours=colours)
