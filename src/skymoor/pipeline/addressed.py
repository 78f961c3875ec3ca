# SPDX-License-Identifier: Apache-2.0
"""References by address in a run: the part that is needed is fetched once into the run's folder, and then is files."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from skymoor.engines.regular import regular
from skymoor.sources.addresses import Addressed, is_address
from skymoor.sources.known import Facts
from skymoor.store import FETCHED, atomic_file, digest
from skymoor.types import Progress

if TYPE_CHECKING:
    from skymoor.pipeline.site import Site

RECORD = "fetched.json"
ORTHO, DSM = Path(FETCHED) / "ortho.tif", Path(FETCHED) / "dsm.tif"
"""Where the files of an addressed reference will lie, below the folder of the run."""


def addressed(root: Path, ortho: object, dsm: object) -> Addressed | None:
    """The sources of a reference if one of them is an address, local paths as they are from `root`; else None."""

    def located(value: object) -> str | None:
        if not isinstance(value, str | Path):
            return None
        return str(value) if is_address(str(value)) else str(root / value)

    first, second = located(ortho), located(dsm)
    if first is None or not any(is_address(one) for one in (first, second) if one is not None):
        return None
    return Addressed(first, second)


def with_files(site: Site, out: Path, track: Callable[[str], Progress], note: Callable[[str], None]) -> Site:
    """The site with the files of its reference, fetched into the folder of the run `out` if they are not there.

    A site without addresses is returned as it is, and nothing touches the network. `track` gives the progress callback
    of a file, by its name. Raises `InputError` as `fetch_reference`.
    """
    if site.addressed is None:
        return site
    asked, area = site.addressed, site.bounds.area
    request = digest([asked.ortho, asked.dsm])
    facts = _fetched_before(out / FETCHED, request, area, note)
    if facts is None:
        from skymoor.sources.fetch import fetch_reference  # loads what reads catalogues, which takes its time

        (out / FETCHED / RECORD).unlink(missing_ok=True)
        found = fetch_reference(asked.ortho, asked.dsm, out / FETCHED, bbox=area, track=track)
        for text in found.notes:
            note(text)
        facts = found.facts
        record = {"request": request, "area": area, "fetched": _now(), "facts": asdict(facts)}
        with atomic_file(out / FETCHED / RECORD) as file:
            file.write(json.dumps(record, ensure_ascii=False, indent=1).encode())
    files, heights = site.reference, asked.dsm is not None
    reference = replace(
        files,
        ortho=out / ORTHO,
        dsm=out / DSM if heights else files.dsm,
        vertical_datum=files.vertical_datum or (facts.vertical_datum if heights else None),
        licence=files.licence or facts.licence,
        credit=files.credit or facts.credit,
        date=files.date or facts.date,
    )
    return replace(site, reference=reference)


def _fetched_before(
    folder: Path, request: str, area: Sequence[float] | None, note: Callable[[str], None]
) -> Facts | None:
    """What is known of the files that were fetched from the same addresses and hold this area; None without any."""
    try:
        record = json.loads(regular(folder / RECORD).read_text(encoding="utf-8"))
        if record["request"] != request or not (folder / ORTHO.name).is_file() or not _holds(record["area"], area):
            return None
        facts = Facts(**record["facts"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    note(f"{folder}: the reference that was fetched on {record['fetched']} is used; delete it to fetch it again")
    return facts


def _holds(there: Sequence[float] | None, area: Sequence[float] | None) -> bool:
    """Whether the area that was fetched, everything without one, holds another."""
    if there is None or area is None:
        return there is None
    return all(a <= b for a, b in zip(there[:2], area[:2], strict=True)) and all(
        a >= b for a, b in zip(there[2:], area[2:], strict=True)
    )


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
