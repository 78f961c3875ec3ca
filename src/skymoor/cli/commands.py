# SPDX-License-Identifier: Apache-2.0
"""What the commands do, between the parsed command line and the pipeline."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

from jinja2 import TemplateError

import skymoor.results.export
from skymoor.cli.arguments import Demo, Doctor, Evaluate, Export, Report, Run, Simulate, View, Weights, WeightsFetch
from skymoor.cli.doctor import examine
from skymoor.cli.progress import Screen
from skymoor.cli.tables import accuracy_table, checks_table, evaluation_table, plan_table, summary_table, weights_table
from skymoor.engines.weights import KNOWN, fetch, weights_folder
from skymoor.errors import InputError
from skymoor.pipeline.airborne import register_airborne
from skymoor.pipeline.estimate import plan
from skymoor.pipeline.ground import register_ground_sets
from skymoor.pipeline.job import Job
from skymoor.pipeline.log import logged
from skymoor.pipeline.options import Options, check_engines
from skymoor.pipeline.provenance import provenance
from skymoor.pipeline.site import Site, load_site, parse_option, site_from_arguments, with_options
from skymoor.reference.read import read_reference
from skymoor.results.read import Result
from skymoor.results.report.page import report_page
from skymoor.results.viewer import view_run
from skymoor.results.write import NOT_REGISTERED, PlacedSet, write_products
from skymoor.simulate import SiteOptions
from skymoor.simulate.site import write_site
from skymoor.simulate.world import World
from skymoor.store import PRODUCTS, Store, check_photos, has_metadata, name_prefix
from skymoor.types import Reference

PAGE = "report.html"
LARGEST_SEED = 2**31 - 1  # COLMAP's

# Small enough for a few minutes on two cores, large enough for every step to have its work.
DEMO = SiteOptions(
    seed=1,
    radius_m=55.0,
    airborne=26,
    groups=1,
    group_photos=11,
    security=0,
    photo_width=640,
    reference_width_m=220.0,
)


def run(command: Run) -> bool:
    """`skymoor run`; returns whether everything was registered."""
    site = _site(command)
    options = with_options(Options(), {**site.options, **dict(map(parse_option, command.set))})
    if site.airborne is None:
        raise InputError(
            f"{command.site}: it names no [airborne] images; ground photos are placed on the airborne model"
        )
    weight_files = check_engines(options, ground=bool(site.ground))
    _require_run(command, site)
    if command.dry_run:
        return _show_plan(command, site, options)
    with (
        Screen(plain=command.quiet, for_scripts=command.json) as screen,
        Store.open(command.out, note=screen.note) as store,
        logged(store.path("run.log")),
    ):
        photos = store.photos("photos", site.airborne, site.root, screen.track("photos"))
        _tell_metadata(site.airborne, screen)
        files = site.reference
        reference = store.stage(
            "reference",
            lambda: _read_reference(site, screen),
            options=[
                *((path, path.stat().st_size, path.stat().st_mtime_ns) for path in (files.ortho, files.dsm)),
                files.vertical_datum,
                files.covariance,
            ],
            code=["skymoor.reference.read", "skymoor.geo"],
        )
        job = Job(photos, reference, options, store, command.seed, screen.track)
        jobs = [job, *(_ground_job(f"ground{k}", folder, site, job) for k, folder in enumerate(site.ground))]
        airborne = register_airborne(job)
        placed = [airborne, *register_ground_sets(jobs[1:], airborne)]
        folders = (site.airborne, *site.ground)
        sets = [
            PlacedSet(job.name, folder, job.photos.names, found)
            for job, folder, found in zip(jobs, folders, placed, strict=True)
        ]
        made_from = provenance(
            (site.reference.ortho, site.reference.dsm),
            {job.name: (folder, job.photos_stage) for job, folder in zip(jobs, folders, strict=True)},
            weight_files,
            store,
        )
        summary = write_products(sets, site, reference, options, command.seed, made_from, store)
        screen.show(summary_table(summary))
        _write_page(Result.read(command.out), store)
        screen.note(f"results in {command.out}; to read: {command.out / PAGE}")
        screen.answer({"out": store.root, "site": summary["site"], "sets": summary["sets"]})
    return all(item["status"] != NOT_REGISTERED for item in summary["sets"])


def evaluate(command: Evaluate) -> None:
    """`skymoor evaluate`."""
    result = Result.read(command.run)
    rows = result.evaluate(command.truth)
    with Screen(plain=True, for_scripts=command.json) as screen, Store.open(command.run) as store:
        screen.answer({"rows": rows})
        store.write_json("evaluation.json", {"truth": command.truth, "rows": [asdict(row) for row in rows]})
        _rewrite_page(result, store)
        screen.show(evaluation_table(rows))
        screen.show(accuracy_table(rows))


def export(command: Export) -> None:
    """`skymoor export`."""
    with Screen(plain=command.quiet) as screen:
        skymoor.results.export.export(Result.read(command.run), command.to, command.out, screen.note, screen.track)


def report(command: Report) -> None:
    """`skymoor report`."""
    result = Result.read(command.run)  # first, or the folder would be made into that of a run
    with Screen(plain=True) as screen, Store.open(command.run) as store:
        screen.note(str(_rewrite_page(result, store)))


def view(command: View) -> None:
    """`skymoor view`."""
    result = Result.read(command.run)
    with Screen(plain=True) as screen:
        view_run(result, port=command.port, browser=command.open, note=screen.note)


def simulate(command: Simulate) -> None:
    """`skymoor simulate`."""
    with Screen(plain=command.quiet) as screen:
        write_site(World(command.options), command.out, progress=screen.track("simulated site"))
        screen.note(f"{command.out / 'site.toml'}: the site; what is true of it stands in truth.csv and truth.json")


def demo(command: Demo) -> bool:
    """`skymoor demo`; returns whether everything was registered."""
    site, result = command.out / "site", command.out / "result"
    simulate(Simulate(out=site, options=DEMO, quiet=command.quiet))
    registered = run(Run(site=site / "site.toml", out=result, quiet=command.quiet))
    evaluate(Evaluate(run=result, truth=site / "truth.csv"))
    with Screen(plain=True) as screen:
        screen.note(
            f"read {result / PAGE} in a browser; pictures are in {result / 'renders'} and {result / 'matches'}, "
            f"all figures in {result / 'summary.json'}"
        )
    return registered


def weights(command: Weights) -> None:
    """`skymoor weights list` and `skymoor weights fetch`."""
    if not isinstance(command.action, WeightsFetch):
        folder = weights_folder()
        with Screen(plain=True, for_scripts=command.action.json) as screen:
            screen.show(weights_table(KNOWN, folder))
            screen.answer({"folder": folder, "weights": KNOWN})
        return
    wanted = command.action
    with Screen(plain=wanted.quiet) as screen:
        for file in fetch(wanted.name, wanted.to or weights_folder(), lambda name: screen.track(f"{name}, MB")):
            digest = "" if file.sha256 is None else f", sha256 {file.sha256}"
            screen.note(f"{file.path}: {'was here' if file.was_there else 'fetched'}{digest}")
        if wanted.to is not None and wanted.to != weights_folder():
            screen.note(f"engines find it there if SKYMOOR_WEIGHTS={wanted.to}")


def _write_page(result: Result, store: Store) -> Path:
    return store.write_text(PAGE, report_page(result))


def _rewrite_page(result: Result, store: Store) -> Path:
    """The same of a folder in which anyone may have written since."""
    try:
        return _write_page(result, store)
    except (LookupError, TypeError, ValueError, AttributeError, TemplateError) as error:
        raise InputError(
            f"{result.folder / 'summary.json'}: is damaged or of another version ({error}); run skymoor run again"
        ) from error


def doctor(command: Doctor) -> bool:
    """`skymoor doctor`; returns whether nothing that is needed is missing."""
    checks = examine(command.out)
    with Screen(plain=True, for_scripts=command.json) as screen:
        screen.show(checks_table(checks))
        screen.answer({"checks": [{**asdict(check), "status": check.status} for check in checks]})
    return all(check.status != "missing" for check in checks)


def _show_plan(command: Run, site: Site, options: Options) -> bool:
    """All input checked, and what a run would do with it; writes nothing."""
    with Screen(plain=command.quiet, for_scripts=command.json) as screen:
        assert site.airborne is not None
        airborne, *ground = (
            check_photos(folder, screen.track(folder.name)) for folder in (site.airborne, *site.ground)
        )
        steps = plan(airborne, ground, _read_reference(site, screen).rgb[..., 0].size, options)
        screen.show(plan_table(steps))
        screen.note("nothing was written; leave out --dry-run to begin")
        screen.answer({"steps": steps})
    return True


def _read_reference(site: Site, screen: Screen) -> Reference:
    files = site.reference
    track = screen.track("reference")
    return read_reference(files.ortho, files.dsm, files.vertical_datum, files.covariance, progress=track)


def _site(command: Run) -> Site:
    if command.site is not None:
        clash = [name for name in ("airborne", "ortho", "dsm") if getattr(command, name) is not None]
        if clash or command.ground:
            raise InputError(f"{command.site} already names the data: leave out --{(clash or ['ground'])[0]}")
        return load_site(command.site, vertical_datum=command.vertical_datum, ce90=command.ce90, le90=command.le90)
    if command.ortho is None or command.dsm is None:
        raise InputError("name a site.toml, or give --airborne, --ortho and --dsm")
    return site_from_arguments(
        command.airborne,
        command.ground,
        command.ortho,
        command.dsm,
        command.vertical_datum,
        command.ce90,
        command.le90,
    )


def _tell_metadata(folder: Path, screen: Screen) -> None:
    count = has_metadata(folder)
    if count:
        screen.note(f"{count} photos carry EXIF or XMP metadata: it is ignored, nothing but pixels is used")


def _ground_job(name: str, folder: Path, site: Site, job: Job) -> Job:
    """The job of a folder of ground photos, which are checked; they are placed once the airborne ones are."""
    stage = f"{name}.photos"
    photos = job.store.photos(stage, folder, site.root, job.track(stage))
    return replace(job, photos=photos, name=name, photos_stage=stage)


def _require_run(command: Run, site: Site) -> None:
    """What would go wrong later, or would harm the user's own files."""
    if not 0 <= command.seed <= LARGEST_SEED:
        raise InputError(f"--seed {command.seed}: give a whole number from 0 to {LARGEST_SEED}")
    folders = [folder for folder in (site.airborne, *site.ground) if folder is not None]
    out = command.out.resolve()
    for path in (site.reference.ortho, site.reference.dsm, *folders):
        inside = path.resolve()
        if inside == out or (inside.is_relative_to(out) and inside.relative_to(out).parts[0] in PRODUCTS):
            raise InputError(f"{path}: lies where the results would be written; give another folder with --out")
    for k, folder in enumerate(folders):
        # Their photos would have the same names, and nobody could tell whose camera is whose.
        twin = next(
            (other for other in folders[:k] if name_prefix(other, site.root) == name_prefix(folder, site.root)), None
        )
        if twin is not None:
            raise InputError(f"{folder}: is named twice, or as {twin} is; name each folder of photos once, differently")
