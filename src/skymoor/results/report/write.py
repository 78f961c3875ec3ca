# SPDX-License-Identifier: Apache-2.0
"""The report in the folder of its run."""

from __future__ import annotations

from pathlib import Path

from jinja2 import TemplateError

from skymoor.errors import InputError
from skymoor.results.read import Result
from skymoor.results.report.page import report_page
from skymoor.store import Store

PAGE = "report.html"


def write_report(result: Result, store: Store) -> Path:
    """Write report.html of the run in `store`; returns where it lies."""
    return store.write_text(PAGE, report_page(result))


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
