# SPDX-License-Identifier: Apache-2.0
"""What the commands do that help a person: `skymoor init` before the first run, `skymoor ask` after a refusal."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from skymoor.cli.guide_arguments import Ask, Init
from skymoor.cli.progress import Screen

if TYPE_CHECKING:
    from skymoor.results.ask.answer import Statement


def init(command: Init) -> None:
    """`skymoor init`."""
    from skymoor.engines.regular import is_there
    from skymoor.errors import InputError
    from skymoor.pipeline.site_draft import Stated, draft_site
    from skymoor.pipeline.site_values import SITE_FILE
    from skymoor.store import atomic_file

    file = command.out if command.out.suffix.lower() == ".toml" else command.out / SITE_FILE
    if is_there(file) or is_there(file, folder=True):
        raise InputError(f"{file}: exists and is not overwritten; edit it, or give another file with --out")
    if not command.photos and not command.ground:
        raise InputError("there are no images; name the folder of the photos, such as skymoor init photos")
    reference = (command.ortho, command.dsm, command.vertical_datum, command.ce90, command.le90, command.accuracy)
    draft = draft_site(file, command.photos, command.ground, Stated(*reference))
    with Screen(plain=True) as screen:
        for line in draft.found:
            screen.note(line)
        with atomic_file(file) as target:
            target.write(draft.text.encode())
        run = f"skymoor run {file} --out result"
        if draft.missing:
            screen.note(f"{file}: written; complete in it what is marked TO DO: {', '.join(draft.missing)}")
            screen.note(f"then check it with: {run} --dry-run")
        else:
            screen.note(f"{file}: written; check it with {run} --dry-run, and leave --dry-run out to begin")


def ask(command: Ask) -> bool | None:
    """`skymoor ask`; returns whether everything is registered now, None where nothing was run."""
    from skymoor import api
    from skymoor.api_models import register_again
    from skymoor.cli.outcome import show_result
    from skymoor.results.ask.answer import ANSWERS, person_of, record_answer
    from skymoor.results.ask.question import question_about, questions_of
    from skymoor.results.ask.server import ask_in_browser
    from skymoor.results.read import Result
    from skymoor.results.request import GIVEN, site_of_run
    from skymoor.store import Store

    result = Result.read(command.folder)
    site = site_of_run(result) if command.run else None  # before somebody takes the trouble to answer
    questions = questions_of(result)
    if command.component is not None:
        questions = [question_about(command.component, questions)]
    with Screen(plain=command.quiet, for_scripts=command.json, verbose=command.verbose) as screen:
        statement = _stated(command)
        if statement.stated:
            person = person_of(result, questions[0], statement)
        else:
            person = ask_in_browser(
                result, questions, port=command.port, browser=command.open, by=command.by, note=screen.note
            )
        with Store.open(command.folder) as store:
            record_answer(store, person)
        screen.note(f"{command.folder / ANSWERS}: {person.record['component']}: {person.record['words']}")
        if site is None:
            screen.answer({"answer": person.record})
            return None
        seed, helped = int(result.summary["seed"]), replace(site, person=person)
        told: dict[str, Any] = {"progress": screen.progress, "note": screen.note}
        if result.components[0].image_set == GIVEN:
            again = register_again(helped, out=command.folder, seed=seed, **told)
        else:
            again = api.register(helped, out=command.folder, seed=seed, planned=screen.begin, **told)
        show_result(screen, again)
    return again.registered


def _stated(command: Ask) -> Statement:
    from skymoor.results.ask.answer import Statement

    return Statement(
        candidate=command.candidate,
        near=command.near,
        area=command.area,
        heading=command.heading,
        north=command.north,
        height=command.height,
        by=command.by,
    )
