# SPDX-License-Identifier: Apache-2.0
"""What engines and options share: fields that are no options of users, and the files of weights that engines read."""

from __future__ import annotations

from dataclasses import Field
from pathlib import Path
from types import MappingProxyType
from typing import Any

FIXED = MappingProxyType({"fixed": True})
"""Metadata of a field that is no option of users: a documented constant, or what the pipeline sets itself."""


def is_fixed(item: Field[Any]) -> bool:
    """Whether a field of a dataclass is no option of users."""
    return bool(item.metadata.get("fixed"))


def files_of(*engines: object) -> tuple[Path, ...]:
    """The files that engines will read; those that read none have no method `ready`. Raises what `ready` raises."""
    return tuple(path for engine in engines if hasattr(engine, "ready") for path in engine.ready())
