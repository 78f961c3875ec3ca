# SPDX-License-Identifier: Apache-2.0
"""The report in the folder of its run."""

from __future__ import annotations

import json
from pathlib import Path

from jinja2 import TemplateError

from skymoor.errors import InputError
from skymoor.results.mosaic import Mosaic, mosaic_of
from skymoor.results.read import HEIGHT_DIFFERENCE, STATISTICS, Result
from skymoor.results.report.figures import distribution
from skymoor.results.report.page import report_page
from skymoor.store import Store

PAGE = "report.html"


def write_report(result: Result, store: Store) -> Path:
    """Write report.html of the run in `store`, and its figures of heights to statistics.json; returns where it lies."""
    mosaic = mosaic_of(result)
    _write_height_difference(result, mosaic, store)
    return store.write_text(PAGE, report_page(result, mosaic))


def _write_height_difference(result: Result, mosaic: Mosaic, store: Store) -> None:
    """The histogram of the page as numbers in metres; with the reports, since the reference has to be read for it."""
    found = None if mosaic.height_difference is None else distribution(mosaic.height_difference)
    if found is None or not result.statistics:  # of former versions, which have no statistics.json
        return
    figures: dict[str, object] = {"n": found.n, "median_m": found.median, "spread_m": found.spread}
    figures |= {"reach_m": found.reach, "counts": found.counts}
    store.write_text(STATISTICS, json.dumps({**result.statistics, HEIGHT_DIFFERENCE: figures}) + "\n")


def rewrite_report(result: Result, store: Store) -> Path:
    """The same of a folder in which anyone may have written since.

    Raises `InputError` where its summary is damaged or of another version.
    """
    try:
        return write_report(result, store)
    except (LookupError, TypeError, ValueError, AttributeError, TemplateError) as error:
        raise InputError(
            f"{result.folder / 'summary.json'}: is damaged or of another version ({error}); run skymoor run again"
        ) from error
