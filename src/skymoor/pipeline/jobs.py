# SPDX-License-Identifier: Apache-2.0
"""What a run works on: its reference, with its local features, and one job for each set of photos."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path

from skymoor.errors import InputError
from skymoor.geo.operations import installed_grids
from skymoor.match.features import Features
from skymoor.pipeline.feature_index import checked_index, reference_features
from skymoor.pipeline.job import Job
from skymoor.pipeline.options import Options
from skymoor.pipeline.photo_sets import PhotoSet, notes_of, require_distinct
from skymoor.pipeline.reference_files import ReferenceFiles
from skymoor.pipeline.site import Site
from skymoor.reference.raster import raster_files
from skymoor.reference.read import read_reference
from skymoor.store import PRODUCTS, Store, has_metadata
from skymoor.types import Progress, Reference

StageProgress = Callable[..., None]
"""Called with the name of a stage, steps done, steps in all, and now and then a line about how it goes."""

LOG = logging.getLogger("skymoor")
LARGEST_SEED = 2**31 - 1  # COLMAP's


def _rasters(files: ReferenceFiles) -> list[Path]:
    """The files of the reference."""
    return [path for path in (files.ortho, files.dsm) if isinstance(path, Path)]


def reference_of(
    site: Site, store: Store, track: Callable[[str], Progress], note: Callable[[str], None]
) -> tuple[Reference, Callable[[], Features]]:
    """The reference of a site, and its local features, which are found when they are first asked for."""
    files = site.reference
    reference = store.stage(
        "reference",
        read_reference,
        files.ortho,
        files.dsm,
        files.vertical_datum,
        files.covariance,
        area=site.bounds.area,
        progress=track("reference"),
        depends_on=(raster_files(*_rasters(files)), installed_grids()),
    )
    for text in reference.notes:
        note(text)
        LOG.info("reference: %s", text)
    index, why_not = checked_index(files.ortho, store.files.sha256(files.ortho))
    if why_not:
        note(why_not)
    features = cache(lambda: store.stage("reference.features", reference_features, reference, files.ortho, index))
    return reference, features


def jobs_of(
    site: Site,
    sets: Sequence[PhotoSet],
    options: Options,
    store: Store,
    seed: int,
    progress: StageProgress,
    note: Callable[[str], None],
) -> list[Job]:
    """One job for each set of photos, all with the same reference."""
    track, jobs = partial(track_stage, progress), []
    for text in notes_of(sets):
        note(text)
    count = has_metadata(sets[0].files.photos)
    if count:
        note(f"{count} photos carry EXIF or XMP metadata: it is ignored, nothing but pixels is used")
    reference, features = reference_of(site, store, track, note)
    known = partial(Job, files=site.reference.rasters, heading=site.bounds.heading)
    for one in sets:
        stage = "photos" if one.name == "airborne" else f"{one.name}.photos"
        photos = store.photos(stage, one.files, options.video, track(stage))
        frames = len(photos) - len(one.files.photos)
        if frames:
            names = ", ".join(video.name for video in one.files.videos)
            note(f"{one.name}: {frames} frames of {names} are taken for photos")
        job = partial(known, features=features) if one.name == "airborne" else Job
        jobs.append(job(photos, reference, options, store, seed, track, one.name))
    return jobs


def track_stage(progress: StageProgress, name: str) -> Progress:
    """The progress callback of a stage."""

    def update(done: int, total: int, note: str = "", /) -> None:
        progress(name, done, total, note)

    return update


def require_run(site: Site, out: Path, seed: int) -> None:
    """What would go wrong later, or would harm the user's own files."""
    if not 0 <= seed <= LARGEST_SEED:
        raise InputError(f"--seed {seed}: give a whole number from 0 to {LARGEST_SEED}")
    sources, where = [source for _, there in site.sets for source in there], out.resolve()
    rasters = [] if site.addressed else _rasters(site.reference)
    given = () if site.control is None else site.control.files
    for path in (*rasters, *given, *sources):
        inside = path.resolve()
        if inside == where or (inside.is_relative_to(where) and inside.relative_to(where).parts[0] in PRODUCTS):
            raise InputError(f"{path}: lies where the results would be written; give another folder with --out")
    require_distinct(site)
