# SPDX-License-Identifier: Apache-2.0
"""report.pdf: the page as a browser prints it, so that both say the same."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from skymoor.errors import BackendUnavailable, SkymoorError
from skymoor.results.report.write import PAGE
from skymoor.store import atomic_file

PDF = "report.pdf"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge", "chrome")
WITHOUT_BROWSER = f"install one, name it in the environment variable CHROMIUM, or print {PAGE} from your own browser"
PRINT_S = 120


def browser() -> str:
    """The browser that prints: the one that CHROMIUM names, else the first of the usual ones on the path.

    Raises `BackendUnavailable` where there is none.
    """
    named = os.environ.get("CHROMIUM")
    found = named if named else next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None:
        raise BackendUnavailable(f"{PDF} is printed by Chromium, Chrome or Edge, and none is here: {WITHOUT_BROWSER}")
    return found


def print_report(folder: Path) -> Path:
    """Print report.html of a run to report.pdf beside it; nothing is loaded from the network.

    Raises `BackendUnavailable` without a browser, and `SkymoorError` where it prints nothing.
    """
    program = browser()
    with tempfile.TemporaryDirectory(prefix="skymoor-") as scratch:
        printed = Path(scratch) / PDF
        command = [program, "--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
        command += [f"--user-data-dir={scratch}/profile", "--no-pdf-header-footer", f"--print-to-pdf={printed}"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:  # Chromium's sandbox does not start for root, as in containers
            command.append("--no-sandbox")
        command.append((folder / PAGE).resolve().as_uri())
        try:
            done = subprocess.run(command, capture_output=True, timeout=PRINT_S, check=False, text=True)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise SkymoorError(f"{program}: does not print {folder / PAGE} ({error})") from error
        if not printed.is_file():
            last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            raise SkymoorError(f"{program}: does not print {folder / PAGE} ({last})")
        with atomic_file(folder / PDF) as out:
            out.write(printed.read_bytes())
    return folder / PDF
