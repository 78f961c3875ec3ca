# SPDX-License-Identifier: Apache-2.0
"""Runs of the small simulated site."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from skymoor.cli.main import main

# Narrower and coarser than the defaults, to save time; the flights are 73 to 77 m above ground.
SEARCH = (
    *("min_height_m=66", "max_height_m=85", "search.template_px=64", "search.reference_px=384"),
    "search.azimuth_step_deg=9",
)
OPTIONS = (*(f"match.{one}" for one in SEARCH), "match.decoys.count=2", "engines.sift.max_features=2500")
FASTER = tuple(word for one in OPTIONS for word in ("--set", one))
SEED = 3


def arguments(toml: Path, out: Path, *more: str) -> list[str]:
    """Of the command line."""
    return ["run", str(toml), "--out", str(out), "--seed", str(SEED), "--quiet", *FASTER, *more]


def run(toml: Path, out: Path, *more: str) -> int:
    """Exit status of the run of a site.toml."""
    return main(arguments(toml, out, *more))


def summary_of(out: Path) -> dict[str, Any]:
    """summary.json."""
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return summary


def rows_of(path: Path) -> list[dict[str, str]]:
    """A table's rows."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
