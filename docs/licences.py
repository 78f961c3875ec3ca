# SPDX-License-Identifier: Apache-2.0
"""Writes docs/licences.md: the licence of every package of skymoor, of its extras and of the tools of development.

    python docs/licences.py

From the metadata of what is installed, in the versions of requirements.lock. A licence that is no permissive one is
marked, since it matters to whoever passes skymoor on.
"""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, distribution, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PAGE = Path(__file__).parent / "licences.md"
LOCK = Path(__file__).parent.parent / "requirements.lock"
EXTRAS = (
    "nerf",
    "kornia",
    "roma",
    "segmentation",
    "depth",
    "retrieval",
    "models",
    "view",
    "hub",
    "plot",
    "table",
    "video",
    "dask",
    "export",
)
COPYLEFT = re.compile(r"\b(A?GPL|LGPL|MPL|EUPL|CDDL)", re.IGNORECASE)
HEAD = """# Licences of what skymoor installs

skymoor is Apache-2.0. Of the packages below, in the versions of `requirements.lock`, those of the plain installation
are marked *core*; the others name the first extra that brings them. What is not permissive is in bold: it may be used
beside skymoor, and has conditions for who passes it on. PLY files are read by plyfile, which is GPL: who passes on a
program that contains the extra `models` passes on the whole under its terms. Packages of compiled code contain
libraries with licences of their own, which their wheels list. Weights of learned engines have licences too: `skymoor
weights list`. `python docs/licences.py` writes this page.

"""
TOOLS = """
## Tools of development

`make dev` installs these as well, for tests, checks and this documentation. No installation of users contains them.

"""
COLUMNS = """| package | version | licence | from |
|---|---|---|---|
"""


def licence(name: str) -> str:
    """As the package's metadata state it: the SPDX expression, a short text, or the classifiers."""
    facts = distribution(name).metadata
    stated = facts.get("License-Expression") or ""
    classified = [
        one.split(" :: ")[-1] for one in facts.get_all("Classifier") or () if one.startswith("License :: OSI")
    ]
    text = (facts.get("License") or "").strip().splitlines()
    found = stated or ", ".join(classified) or (text[0] if text and len(text[0]) < 60 else "") or "see its files"
    return f"**{found}**" if COPYLEFT.search(found) else found


def closure(roots: list[str], extras: frozenset[str] = frozenset()) -> set[str]:
    """The packages that some need here, with themselves; those that are not installed are left out."""
    found: set[str] = set()
    waiting = [(canonicalize_name(root), extras) for root in roots]
    while waiting:
        name, own = waiting.pop()
        try:
            needed = requires(name) or []
        except PackageNotFoundError:
            continue
        if name in found and not own:
            continue
        found.add(name)
        for one in map(Requirement, needed):
            wanted = [{"extra": extra} for extra in own] or [{"extra": ""}]
            if one.marker is None or any(one.marker.evaluate(values) for values in wanted):
                new = canonicalize_name(one.name)
                if new not in found or (one.extras and new != "skymoor"):
                    waiting.append((new, frozenset(one.extras)))
    return found


def main() -> None:
    """Write the page."""
    versions = dict(line.split("==") for line in LOCK.read_text().splitlines() if "==" in line and line[0] != "#")
    versions = {canonicalize_name(name): version.split()[0] for name, version in versions.items()}
    source = dict.fromkeys(closure(["skymoor"]), "core")
    for extra in EXTRAS:
        for name in closure(["skymoor"], frozenset([extra])):
            source.setdefault(name, extra)
    tools = closure(["skymoor"], frozenset(["dev"])) - set(source)
    source.pop("skymoor")

    def table(origins: dict[str, str]) -> str:
        rows = [
            f"| {name} | {versions.get(name, '')} | {licence(name)} | {origins[name]} |" for name in sorted(origins)
        ]
        return COLUMNS + "\n".join(rows) + "\n"

    PAGE.write_text(HEAD + table(source) + TOOLS + table(dict.fromkeys(tools, "dev")), encoding="utf-8")


if __name__ == "__main__":
    main()
