# SPDX-License-Identifier: Apache-2.0
"""What the commands do: parse, call, print. Each loads only what it uses, because some libraries take seconds."""

from __future__ import annotations

from dataclasses import asdict, replace

from skymoor.cli.arguments import (
    Clean,
    Demo,
    Evaluate,
    Export,
    Index,
    Reference,
    Report,
    Run,
    Simulate,
    View,
)
from skymoor.cli.progress import Screen
from skymoor.cli.register_arguments import Register
from skymoor.pipeline.words import size_in_words
from skymoor.simulate.options import SiteOptions

# Small enough for a few minutes on two cores, large enough for every step to have its work. A site whose walk shows
# enough to be placed with a margin: those of seeds 1 and 2 are refused, narrowly, which a first run should not show.
DEMO = SiteOptions(
    seed=3,
    radius_m=55.0,
    airborne=26,
    groups=1,
    group_photos=12,
    security=0,
    photo_width=640,
    reference_width_m=220.0,
)


def run(command: Run) -> bool:
    """`skymoor run`; returns whether everything was registered."""
    from skymoor import api
    from skymoor.cli.outcome import show_result
    from skymoor.cli.tables import plan_table
    from skymoor.engines.regular import is_there
    from skymoor.pipeline.option_parser import parse_option
    from skymoor.pipeline.prior import SearchPrior
    from skymoor.pipeline.site_control import control_with_arguments
    from skymoor.pipeline.stopping import StoppedAfter
    from skymoor.results.ask.answer import ANSWERS

    options = dict(map(parse_option, command.set))
    if command.fps is not None:
        options["video.fps"] = command.fps
    site = api.site_of(
        command.site,
        airborne=command.airborne,
        ground=command.ground,
        ortho=command.ortho,
        dsm=command.dsm,
        vertical_datum=command.vertical_datum,
        ce90=command.ce90,
        le90=command.le90,
        accuracy=command.accuracy,
        reference_run=command.reference_run,
    )
    site = site.bounded(SearchPrior.of(command.area, command.near, command.heading, command.height))
    stated = (command.control, command.control_ce90, command.control_le90, command.control_datum)
    site = replace(site, control=control_with_arguments(site.control, *stated, use=command.use_control))
    with Screen(plain=command.quiet, for_scripts=command.json, verbose=command.verbose) as screen:
        if command.site is not None and command.site.is_dir():
            screen.note(f"{site.source}: this file in the folder is used")
        if is_there(command.out / ANSWERS):
            screen.note(f"{command.out / ANSWERS}: what a person stated is not used by this run, only by skymoor ask")
        if command.dry_run:
            steps = api.plan(
                site, options, out=command.out, seed=command.seed, progress=screen.progress, note=screen.note
            )
            screen.show(plan_table(steps))
            screen.note("nothing was written; leave out --dry-run to begin")
            screen.answer({"steps": steps})
            return True
        try:
            result = api.register(
                site,
                out=command.out,
                options=options,
                seed=command.seed,
                stop_after=command.stop_after,
                progress=screen.progress,
                note=screen.note,
                planned=screen.begin,
            )
        except StoppedAfter as stop:
            screen.note(str(stop))
            screen.answer({"out": command.out.resolve(), "stopped_after": stop.step})
            return True
        show_result(screen, result)
    return result.registered and (result.heights_confirmed or not command.require_heights)


def register(command: Register) -> bool:
    """`skymoor register`; returns whether the model is registered."""
    from skymoor.api_models import register_model
    from skymoor.cli.outcome import show_result
    from skymoor.pipeline.option_parser import parse_option
    from skymoor.results.placed import PLACED

    with Screen(plain=command.quiet, for_scripts=command.json, verbose=command.verbose) as screen:
        result = register_model(
            command.model,
            out=command.out,
            ortho=command.ortho,
            dsm=command.dsm,
            photos=command.photos,
            vertical_datum=command.vertical_datum,
            ce90=command.ce90,
            le90=command.le90,
            accuracy=command.accuracy,
            reference_run=command.reference_run,
            area=command.area,
            near=command.near,
            control=command.control,
            control_ce90=command.control_ce90,
            control_le90=command.control_le90,
            control_datum=command.control_datum,
            use_control=command.use_control,
            options=dict(map(parse_option, command.set)),
            seed=command.seed,
            progress=screen.progress,
            note=screen.note,
        )
        show_result(screen, result)
        if result.registered:
            screen.note(f"the model's own files, moved: {command.out / PLACED}")
    return result.registered and (result.heights_confirmed or not command.require_heights)


def evaluate(command: Evaluate) -> None:
    """`skymoor evaluate`."""
    from skymoor.cli.tables import evaluation_table
    from skymoor.results.read import Result
    from skymoor.results.report.write import rewrite_report
    from skymoor.store import Store

    result = Result.read(command.run)
    rows = result.evaluate(command.truth)
    with Screen(plain=True, for_scripts=command.json) as screen, Store.open(command.run) as store:
        screen.answer({"rows": rows})
        store.write_json("evaluation.json", {"truth": command.truth, "rows": [asdict(row) for row in rows]})
        rewrite_report(result, store)
        screen.show(evaluation_table(rows))
        for row in rows:
            if row.n_without_truth:
                missing = f"{row.n_without_truth} of {row.n_cameras} registered cameras have no line in {command.truth}"
                screen.note(f"{row.set} {row.component}: {missing}, and are not evaluated")


def export(command: Export) -> None:
    """`skymoor export`."""
    from skymoor.results.export import export as write_exports
    from skymoor.results.read import Result

    with Screen(plain=command.quiet, verbose=command.verbose) as screen:
        write_exports(Result.read(command.run), command.to, command.out, screen.note, screen.track)


def report(command: Report) -> None:
    """`skymoor report`."""
    from skymoor.results.read import Result
    from skymoor.results.report.pdf import print_report
    from skymoor.results.report.write import PAGE, rewrite_report
    from skymoor.store import Store

    result = Result.read(command.run)  # first, or the folder would be made into that of a run
    with Screen(plain=True) as screen, Store.open(command.run) as store:
        rewrite_report(result, store)
        screen.note(f"{command.run / PAGE}: written; it needs no network")
        if command.pdf:
            screen.note(f"{print_report(command.run)}: printed")


def view(command: View) -> None:
    """`skymoor view`."""
    from skymoor.results.read import Result
    from skymoor.results.viewer import view_run

    result = Result.read(command.run)
    with Screen(plain=True) as screen:
        view_run(result, port=command.port, browser=command.open, note=screen.note)


def clean(command: Clean) -> None:
    """`skymoor clean`."""
    from skymoor.errors import InputError
    from skymoor.store import Store, is_run

    if not is_run(command.run):
        raise InputError(f"{command.run}: is no folder of a run; give the one that skymoor run wrote with --out")
    with Screen(plain=True) as screen, Store.open(command.run) as store:
        freed = store.clean()
        screen.note(f"{command.run}: {size_in_words(freed)} freed; the results are kept, the same run starts anew")


def simulate(command: Simulate) -> None:
    """`skymoor simulate`."""
    from skymoor.simulate.site import write_site
    from skymoor.simulate.world import World

    with Screen(plain=command.quiet, verbose=command.verbose) as screen:
        write_site(World(command.options), command.out, progress=screen.track("simulated site"))
        screen.note(f"{command.out / 'site.toml'}: the site; its truth is in truth.csv and truth.json")


def demo(command: Demo) -> bool:
    """`skymoor demo`; returns whether everything was registered."""
    site, result = command.out / "site", command.out / "result"
    simulate(Simulate(out=site, options=DEMO, quiet=command.quiet, verbose=command.verbose))
    registered = run(Run(site=site / "site.toml", out=result, quiet=command.quiet, verbose=command.verbose))
    evaluate(Evaluate(run=result, truth=site / "truth.csv"))
    with Screen(plain=True) as screen:
        screen.note(
            f"read {result / 'report.html'} in a browser (skymoor report {result} --pdf prints it); pictures are in "
            f"{result / 'renders'} and {result / 'matches'}, all numbers in {result / 'summary.json'}"
        )
    return registered


def reference(command: Reference) -> None:
    """`skymoor reference`."""
    from skymoor.sources.fetch import fetch_reference

    with Screen(plain=command.quiet, verbose=command.verbose) as screen:
        found = fetch_reference(
            command.ortho,
            command.dsm,
            command.out,
            bbox=command.bbox,
            pixel_m=command.pixel,
            date=command.date,
            track=screen.track,
        )
        for text in found.notes:
            screen.note(text)
        rights = "; ".join(text for text in (found.facts.licence, found.facts.credit) if text)
        screen.note(f"licence and credit: {rights or 'the source does not say; ask for them before you publish'}")
        screen.note(f"{found.table}: the table [reference] for site.toml; add the photos, and what it says is missing")


def index(command: Index) -> None:
    """`skymoor index`."""
    from skymoor.pipeline.feature_index import write_index
    from skymoor.pipeline.site import load_site

    named = command.reference
    ortho = load_site(named).reference.ortho if named.suffix.lower() == ".toml" else named
    with Screen(plain=command.quiet, verbose=command.verbose) as screen:
        file, count = write_index(ortho, progress=screen.track("index, tiles"))
        size = size_in_words(file.stat().st_size)
        screen.note(f"{file}: {count} local features, {size}; runs on {ortho} use them from now on")
