# SPDX-License-Identifier: Apache-2.0
"""What the arguments of all commands have in common: short forms, and how their help names what they are without."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar, get_type_hints

import tyro

Out = Annotated[Path, tyro.conf.arg(aliases=["-o"])]
Quiet = Annotated[bool, tyro.conf.arg(aliases=["-q"])]
Verbose = Annotated[bool, tyro.conf.arg(aliases=["-v"])]

UNSAID = ("None", "False", "True", "")
"""Defaults that say nothing: the argument is just left out."""
Kind = TypeVar("Kind", bound=type)


def _default(label: str) -> str:
    return "" if label in UNSAID else f"(default: {label})"


def helpful(kind: Kind) -> Kind:
    """A command whose help does not name defaults that say nothing."""
    hint = tyro.conf.arg(help_behavior_hint=_default)
    hints = get_type_hints(kind, include_extras=True)
    kind.__annotations__ = {name: Annotated[found, hint] for name, found in hints.items()}
    return kind
