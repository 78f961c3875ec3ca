# SPDX-License-Identifier: Apache-2.0
"""What the docstrings say of options: for the page of options and for the schema of site.toml."""

from __future__ import annotations

import inspect
import re

ENTRY = re.compile(r"^    (\w+(?:, \w+)*): (.*)")


def descriptions_of(kind: type) -> dict[str, str]:
    """What the docstring of a dataclass and of those that it extends says of each field."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        found |= _described(base)
    return found


def _described(kind: type) -> dict[str, str]:
    found: dict[str, str] = {}
    names: list[str] = []
    lines = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:\n")[2].splitlines()
    for line in lines:
        entry = ENTRY.match(line)
        if entry:
            names = entry[1].split(", ")
            found |= dict.fromkeys(names, entry[2])
        elif line.startswith("        "):
            found |= {name: f"{found[name]} {line.strip()}" for name in names}
        else:
            names = []
    return found
