# SPDX-License-Identifier: Apache-2.0
"""skymoor for notebooks and scripts: the whole job, and its steps one by one. The command line calls it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from skymoor.engines.temporary import temporary_folder
from skymoor.errors import InputError
from skymoor.pipeline.addressed import with_files
from skymoor.pipeline.estimate import Step, estimate_jobs, estimate_run
from skymoor.pipeline.job import Job
from skymoor.pipeline.jobs import StageProgress, jobs_of, require_run, track_stage
from skymoor.pipeline.log import logged
from skymoor.pipeline.option_parser import with_options
from skymoor.pipeline.options import Options, check_engines
from skymoor.pipeline.photo_sets import find_sets, notes_of, sizes_of
from skymoor.pipeline.prior import SearchPrior
from skymoor.pipeline.provenance import provenance
from skymoor.pipeline.register_sets import register_sets, stop_sets
from skymoor.pipeline.site import Site, load_site, site_from_arguments, site_on_run
from skymoor.pipeline.site_control import control_with_arguments
from skymoor.pipeline.site_values import site_file
from skymoor.pipeline.stopping import STEPS, StopAfter
from skymoor.reference.read import read_reference
from skymoor.results.changes import write_changes
from skymoor.results.read import Result
from skymoor.results.report.write import write_report
from skymoor.results.write import SetResult, write_products
from skymoor.store import Store

Where = str | PathLike[str]


def ignore(*_: object) -> None:
    """Ignore progress and notes."""


def register(
    site: Where | Site | None = None,
    *,
    out: Where,
    airborne: Where | Sequence[Where] | None = None,
    ground: Where | Sequence[Where] = (),
    ortho: Where | None = None,
    dsm: Where | float | None = None,
    vertical_datum: str | None = None,
    ce90: float | None = None,
    le90: float | None = None,
    accuracy: str | None = None,
    reference_run: Where | None = None,
    area: Sequence[float] | None = None,
    near: Sequence[float] | None = None,
    heading: str | float | None = None,
    height: float | None = None,
    control: Where | Sequence[Where] = (),
    control_ce90: float | None = None,
    control_le90: float | None = None,
    control_datum: str | None = None,
    use_control: bool = False,
    options: Mapping[str, object] | None = None,
    seed: int = 0,
    stop_after: StopAfter | None = None,
    progress: StageProgress = ignore,
    note: Callable[[str], None] = ignore,
    planned: Callable[[Sequence[Step]], None] = ignore,
) -> Result:
    """Register a site's photos on the Earth, and read back what came of it. Nothing is printed.

    Call it again with the same `out` to go on where it stopped.

    Args:
        site: site.toml, its folder, or one that was loaded; or name the data by `airborne`, `ortho` and `dsm`.
        out: folder for the results.
        airborne: folder of airborne photos, or a video; several are one set. Sub-folders count.
        ground: a folder of ground photos, or a video; each of several is a set of its own.
        ortho: orthophoto, any CRS that GDAL reads; or its address (https://, s3://, STAC, tiles): the part in `area` or
            `near` is then fetched once, into the folder `out`.
        dsm: its surface model, in any unit that the file states; or one height of the ground in metres. Without it
            models are placed on the map, but not in height.
        vertical_datum: what these heights refer to: "ellipsoid", or an EPSG code such as "EPSG:3855".
        ce90: circular error of the reference, 90 percent, metres.
        le90: linear (vertical) error of the reference, 90 percent, metres; not needed without heights.
        accuracy: "unknown" in place of the two: what is registered then has an accuracy relative to the reference only.
        reference_run: folder of an earlier run whose products are the reference, in place of `ortho` and what follows.
        area: where to search: west, south, east and north in degrees.
        near: the same as latitude, longitude and a radius in metres.
        heading: compass direction in degrees, right within 20, in which the first photo looks, or its upper edge if it
            looks straight down; of another photo as "PHOTO=DEGREES".
        height: flying height above the ground in metres, right within a quarter.
        control: files of control points, known camera positions or scale bars; docs/control.md lists the kinds.
        control_ce90: circular error of control, 90 percent, metres, for what its files do not say.
        control_le90: linear error of its heights, 90 percent, metres.
        control_datum: vertical datum of its heights: "ellipsoid", or an EPSG code.
        use_control: move models onto it; otherwise they are compared with it.
        options: by dotted names or nested, such as {"match.max_height_m": 150}; they overrule those of the site.
        seed: makes a run repeatable.
        stop_after: the last step to do: "reconstruct", "depth" or "search"; the same call without it goes on from
            there. Products of an earlier run in `out` stay.
        progress: called with the name of a stage, steps done and in all, and now and then a line: progress("search",
            3, 40). `note` is called with one line for each irregularity.
        planned: called once, when the input is read, with the steps to come and about how long each takes.

    Returns:
        The result, also where a component is refused: `Result.registered` and the reasons of its components say so.

    Raises:
        InputError: data or options are wrong; one line names the file and the remedy.
        BackendUnavailable: an optional engine was chosen that is not installed, or whose weights are not here.
        StoppedAfter: the run has come to the end of the step `stop_after`; there is no result yet.
    """
    if stop_after is not None and stop_after not in STEPS:
        raise InputError(f"stop_after={stop_after!r}: give one of {', '.join(STEPS)}")
    reference: dict[str, Any] = {"ortho": ortho, "dsm": dsm, "vertical_datum": vertical_datum}
    reference |= {"ce90": ce90, "le90": le90, "accuracy": accuracy, "reference_run": reference_run}
    loaded = site_of(site, airborne=airborne, ground=ground, **reference)
    loaded = loaded.bounded(SearchPrior.of(area, near, heading, height))
    stated = (paths_of(control), control_ce90, control_le90, control_datum)
    loaded = replace(loaded, control=control_with_arguments(loaded.control, *stated, use=use_control))
    chosen = with_options(Options(), {**loaded.options, **loaded.bounds.options(), **(options or {})})
    weights = check_engines(chosen, ground=bool(loaded.ground))
    require_run(loaded, Path(out), seed)
    sets = find_sets(loaded)
    with Store.open(Path(out), note=note) as store, logged(store.path("run.log")):
        loaded = with_files(loaded, store.root, partial(track_stage, progress), note)
        jobs = jobs_of(loaded, sets, chosen, store, seed, progress, note)
        if stop_after is not None:
            stop_sets(stop_after, loaded, jobs, note)
        planned(estimate_jobs(jobs))
        results = register_sets(loaded, jobs, note)
        found = [
            SetResult(one.name, one.sources, job.photos.names, result, one.files.notes)
            for one, job, result in zip(sets, jobs, results, strict=True)
        ]
        return finished(found, loaded, jobs, weights, Path(out))


def finished(sets: Sequence[SetResult], site: Site, jobs: Sequence[Job], weights: Sequence[Path], out: Path) -> Result:
    """Write products and report of what the jobs, one for each set, have found, and read them back.

    `weights` are the files of those that the engines read, and `out` is the folder as the user named it.
    """
    job, reference = jobs[0], site.reference
    photos = {one.name: one.photos for one in jobs}
    made_from = provenance((reference.ortho, reference.dsm), photos, weights, job.store)
    products = job.track("products")
    write_products(sets, site, job.reference, job.options, job.seed, made_from, job.store, progress=products)
    result = Result.read(out)
    write_changes(result, reference.run, job.store)
    write_report(result, job.store)
    return result


def plan(
    site: Site,
    options: Mapping[str, object],
    *,
    out: Where,
    seed: int = 0,
    progress: StageProgress = ignore,
    note: Callable[[str], None] = ignore,
) -> list[Step]:
    """The steps of a run, with about how long each takes, after a check of all input; writes nothing.

    Arguments and errors are those of `register`.
    """
    chosen = with_options(Options(), {**site.options, **site.bounds.options(), **options})
    check_engines(chosen, ground=bool(site.ground))
    require_run(site, Path(out), seed)
    sets = find_sets(site)
    for text in notes_of(sets):
        note(text)
    sizes = [sizes_of(one, chosen.video, partial(track_stage, progress)) for one in sets]
    airborne, ground = (sizes[0], sizes[1:]) if site.airborne else ((), sizes)
    with temporary_folder() as scratch:
        files = with_files(site, scratch, partial(track_stage, progress), note).reference
        reference = read_reference(
            files.ortho,
            files.dsm,
            files.vertical_datum,
            files.covariance,
            area=site.bounds.area,
            progress=track_stage(progress, "reference"),
        )
    for text in reference.notes:
        note(text)
    return estimate_run(airborne, ground, reference.rgb[..., 0].size, chosen)


def site_of(
    site: Where | Site | None = None,
    *,
    airborne: Where | Sequence[Where] | None = None,
    ground: Where | Sequence[Where] = (),
    ortho: Where | None = None,
    dsm: Where | float | None = None,
    vertical_datum: str | None = None,
    ce90: float | None = None,
    le90: float | None = None,
    accuracy: str | None = None,
    reference_run: Where | None = None,
) -> Site:
    """The site that these describe; see `register` for the arguments. Raises `InputError` where they clash or lack."""
    if isinstance(site, Site):
        return site
    photos, folders = paths_of(airborne or ()), paths_of(ground)
    given = {"airborne": photos or None, "ortho": ortho, "dsm": dsm, "ground": folders or None}
    given["reference-run"] = reference_run
    if site is not None:
        site = site_file(Path(site))
        clash = next((name for name, value in given.items() if value is not None), None)
        if clash is not None:
            raise InputError(f"{site} already names the data: leave out --{clash}")
        return load_site(Path(site), vertical_datum=vertical_datum, ce90=ce90, le90=le90, accuracy=accuracy)
    if reference_run is not None:
        stated = {"ortho": ortho, "dsm": dsm, "vertical-datum": vertical_datum, "ce90": ce90, "le90": le90}
        return _site_on_run(photos, folders, Path(reference_run), stated | {"accuracy": accuracy})
    if ortho is None:
        raise InputError("name a site.toml, or give --airborne or --ground, --ortho and, where there is one, --dsm")
    heights = None if dsm is None else float(dsm) if isinstance(dsm, int | float) else fspath(dsm)
    return site_from_arguments(photos, folders, fspath(ortho), heights, vertical_datum, ce90, le90, accuracy)


def _site_on_run(photos: Sequence[Path], folders: Sequence[Path], run: Path, stated: Mapping[str, object]) -> Site:
    clash = next((name for name, value in stated.items() if value is not None), None)
    if clash is not None:
        raise InputError(f"--reference-run {run} already names the reference: leave out --{clash}")
    return site_on_run(photos, folders, run)


def paths_of(given: Where | Sequence[Where]) -> tuple[Path, ...]:
    """Of one, or of several."""
    return tuple(Path(one) for one in ([given] if isinstance(given, str | PathLike) else given))
