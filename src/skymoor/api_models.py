# SPDX-License-Identifier: Apache-2.0
"""Models of other programs, registered from notebooks and scripts. The command line calls it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from skymoor.api import Where, finished, ignore, paths_of, site_of
from skymoor.errors import InputError
from skymoor.model.views import RenderOptions
from skymoor.models import GivenModel, Plan, read_model
from skymoor.models.render import level_of, render_given
from skymoor.pipeline.addressed import with_files
from skymoor.pipeline.control import control_of, with_control
from skymoor.pipeline.given_model import register_given
from skymoor.pipeline.job import Job
from skymoor.pipeline.jobs import StageProgress, reference_of, require_run, track_stage
from skymoor.pipeline.log import logged
from skymoor.pipeline.option_parser import with_options
from skymoor.pipeline.options import Options, check_engines
from skymoor.pipeline.prior import SearchPrior
from skymoor.pipeline.site import Site
from skymoor.pipeline.site_control import control_with_arguments
from skymoor.results.placed import place_model
from skymoor.results.read import Result
from skymoor.results.request import GIVEN
from skymoor.results.write import SetResult
from skymoor.store import Store
from skymoor.types import Image, Photos, Render


def register_model(
    model: Where | Sequence[Where],
    *,
    out: Where,
    ortho: Where | None = None,
    dsm: Where | float | None = None,
    photos: Where | None = None,
    vertical_datum: str | None = None,
    ce90: float | None = None,
    le90: float | None = None,
    accuracy: str | None = None,
    reference_run: Where | None = None,
    area: Sequence[float] | None = None,
    near: Sequence[float] | None = None,
    control: Where | Sequence[Where] = (),
    control_ce90: float | None = None,
    control_le90: float | None = None,
    control_datum: str | None = None,
    use_control: bool = False,
    options: Mapping[str, object] | None = None,
    seed: int = 0,
    progress: StageProgress = ignore,
    note: Callable[[str], None] = ignore,
) -> Result:
    """Register a model of another program on the Earth, and move its files there. Nothing is printed.

    Call it again with the same `out` to go on where it stopped.

    Args:
        model: a project's folder, a file, or several files that share one coordinate system, such as an orthophoto and
            its DSM: docs/your-models.md lists the kinds.
        out: folder for the results; the moved files are in its folder `placed`.
        ortho: orthophoto of the reference, or its address; this and the following as in `register`.
        dsm: its surface model, or one height in metres.
        photos: folder of the photos that the model was made from, where they are not beside it.
        vertical_datum: of the heights of the reference.
        ce90: circular error of the reference, 90 percent, metres.
        le90: its linear error.
        accuracy: "unknown" in place of the two.
        reference_run: folder of an earlier run whose products are the reference, in place of these.
        area: where to search: west, south, east and north in degrees.
        near: the same as latitude, longitude and a radius in metres.
        control: files of control points, known camera positions or scale bars, of models with cameras.
        control_ce90: circular error of control, 90 percent, metres, for what the files do not say.
        control_le90: linear error of its heights.
        control_datum: vertical datum of its heights.
        use_control: move the model onto it; otherwise it is compared with it.
        options: by dotted names or nested.
        seed: makes a run repeatable.
        progress: called with the name of a stage, steps done and in all, and now and then a line.
        note: called with one line for each irregularity.

    Returns:
        The result, whose only set of photos is called `model`; also where the model is refused.

    Raises:
        InputError: data or options are wrong, or the model is mirrored; one line names the file and the remedy.
        BackendUnavailable: a library or an engine is needed that is not installed.
    """
    paths = paths_of(model)
    if not paths:
        raise InputError("name the model: skymoor register MODEL --ortho ... --out ...")
    site = site_of(
        airborne=paths,
        ortho=ortho,
        dsm=dsm,
        vertical_datum=vertical_datum,
        ce90=ce90,
        le90=le90,
        accuracy=accuracy,
        reference_run=reference_run,
    ).bounded(SearchPrior.of(area, near))
    stated = (paths_of(control), control_ce90, control_le90, control_datum)
    site = replace(site, control=control_with_arguments(None, *stated, use=use_control))
    site = replace(site, photos=None if photos is None else Path(photos))
    return register_again(site, out=out, options=options, seed=seed, progress=progress, note=note)


def render_orthophoto(ortho: Where, dsm: Where | None = None, *, seed: int = 0) -> Render:
    """An orthophoto whose place is not known, as the view from above that `match_rasters` and `lift` take.

    Its level frame is in units of the file, with the middle of the orthophoto as its origin, rows along x, and z = 0 at
    the ground. Without a DSM it is a plane. A DSM counts only where both files have a geotransform, which states the
    size of a pixel in the unit of the heights, whatever place and CRS it claims.

    Raises:
        InputError: a file cannot be read, or the two do not belong together.
    """
    given = read_model(paths_of(ortho if dsm is None else [ortho, dsm]))
    if not isinstance(given.surface, Plan):
        raise InputError(f"{ortho}: is no orthophoto; give an image, and its DSM as the second file")
    level_from_model, _ = level_of(given.surface, given.up, np.random.default_rng(seed))
    return render_given(given.surface, level_from_model, RenderOptions())


def register_again(
    site: Site,
    *,
    out: Where,
    options: Mapping[str, object] | None = None,
    seed: int = 0,
    progress: StageProgress = ignore,
    note: Callable[[str], None] = ignore,
) -> Result:
    """`register_model` of a site whose airborne paths are the model's, as `site_of_run` reads it from a summary."""
    paths = site.airborne
    chosen = with_options(Options(), {**site.options, **site.bounds.options(), **(options or {})})
    weights = check_engines(chosen, ground=False)
    require_run(site, Path(out), seed)
    given = read_model(paths, site.photos)
    site = replace(site, name=given.name)
    with Store.open(Path(out), note=note) as store, logged(store.path("run.log")):
        for text in given.notes:
            note(text)
        site = with_files(site, store.root, partial(track_stage, progress), note)
        job = _job(site, given, chosen, store, seed, progress, note)
        known, lines = control_of(site.control, [job])
        for text in lines:
            note(text)
        (found,) = with_control([register_given(given, job)], known, job)
        moved = place_model(given, found, job.reference, store, job.track("moved files"))
        for text in moved:
            note(text)
        result = SetResult(GIVEN, paths, job.photos.names, [found], (*given.notes, *moved))
        return finished([result], site, [job], weights, Path(out))


def _job(
    site: Site,
    given: GivenModel,
    options: Options,
    store: Store,
    seed: int,
    progress: StageProgress,
    note: Callable[[str], None],
) -> Job:
    track = partial(track_stage, progress)
    reference, features = reference_of(site, store, track, note)
    photos = given.photos or Photos(_images(given), (), _none, [(part.kind, part.path.name) for part in given.parts])
    return Job(photos, reference, options, store, seed, track, GIVEN, site.reference.rasters, features=features)


def _images(given: GivenModel) -> tuple[str, ...]:
    """Names of the model's cameras whose photos are not here."""
    return () if given.component is None else tuple(camera.image for camera in given.component.cameras)


def _none(name: str) -> Image:
    raise KeyError(f"{name}: the photos of the model are not here")
