# SPDX-License-Identifier: Apache-2.0
"""Libraries and devices that not every installation has: imported when an engine is called, never before."""

from __future__ import annotations

import importlib
import importlib.metadata
from types import ModuleType

from skymoor.errors import BackendUnavailable


def require(module: str, extra: str) -> ModuleType:
    """Import an optional library.

    Args:
        module: its name, dotted for a part of it.
        extra: which of skymoor's extras installs it.

    Raises:
        BackendUnavailable: it is not installed, or is there and does not start; one line says what to install.
    """
    try:
        return importlib.import_module(module)
    # A binary library that does not fit the others fails with errors of its own, not with ImportError.
    except (ImportError, OSError, RuntimeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BackendUnavailable(
            f'{module} cannot be imported ({reason}): install it with pip install "skymoor[{extra}]"'
        ) from error


def version_of(library: str) -> str | None:
    """Of an installed library, by the name that pip knows; None where it is not here."""
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return None


def torch_device(name: str) -> str:
    """`cpu` or `cuda`; `auto` takes CUDA where there is one.

    Raises `BackendUnavailable` if PyTorch is not installed, or CUDA is asked for and missing.
    """
    torch = require("torch", "nerf")
    if name not in ("auto", "cpu", "cuda"):
        raise BackendUnavailable(f"device = {name}: it is auto, cpu or cuda")
    found = torch.cuda.is_available()
    if name == "cuda" and not found:
        raise BackendUnavailable("device = cuda, but PyTorch sees no CUDA device: take cpu or auto")
    return "cuda" if name == "cuda" or (name == "auto" and found) else "cpu"
