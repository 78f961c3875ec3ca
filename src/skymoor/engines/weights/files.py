# SPDX-License-Identifier: Apache-2.0
"""Where weights lie, and reading them without trust."""

from __future__ import annotations

import hashlib
import os
import pickle
import warnings
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

from skymoor.errors import BackendUnavailable, InputError

if TYPE_CHECKING:
    import torch


def weights_folder() -> Path:
    """$SKYMOOR_WEIGHTS, or skymoor/weights in the user's folder of data."""
    chosen = os.environ.get("SKYMOOR_WEIGHTS")
    if chosen:
        return Path(chosen).expanduser()
    data = os.environ.get("XDG_DATA_HOME")
    return (Path(data) if data else Path.home() / ".local/share") / "skymoor/weights"


def find(name: str, file: str, given: str | Path = "") -> Path:
    """The path of a file, or of a folder, of weights.

    Args:
        name, file: as in the table.
        given: path from the user; empty for the folder of weights.

    Raises:
        InputError: nothing is at the path that is given.
        BackendUnavailable: nothing is given, and it has not been fetched.
    """
    if str(given) not in ("", "."):
        path = Path(given).expanduser()
        if not path.exists():
            raise InputError(f"{path}: there are no weights here; give the path of {file}, or none")
        return path
    path = weights_folder() / name / file
    if not path.exists():
        raise BackendUnavailable(f"{path}: the weights of {name} are missing; fetch them: skymoor weights fetch {name}")
    return path


def files_in(paths: Collection[Path]) -> list[Path]:
    """Files, and all files in folders."""
    return [
        file for path in paths for file in ([path] if path.is_file() else sorted(path.rglob("*"))) if file.is_file()
    ]


def stamps(paths: Collection[Path]) -> tuple[tuple[str, int, int], ...]:
    """Path, size and time of change of files, and of all files in folders: other weights, other results."""
    return tuple((str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files_in(paths))


def sha256_of(path: Path) -> str:
    """Digest of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def verify(path: Path, sha256: str) -> None:
    """Raise `InputError` if a file is not the one that has this digest."""
    found = sha256_of(path)
    if found != sha256.lower():
        raise InputError(
            f"{path}: not the expected file (sha256 {found}, expected {sha256}); delete it and fetch it again"
        )


def load_state_dict(path: Path, *, part: str = "") -> dict[str, torch.Tensor]:
    """Read a network's tensors by name, to the CPU; no code in the file is run.

    Args:
        path: a checkpoint of PyTorch, or a file that ends in .safetensors.
        part: the entry of a checkpoint that holds the tensors, where it holds other things too; a checkpoint without
            that entry is taken as the tensors themselves.

    Raises:
        InputError: the file is missing, cut off, or no checkpoint, or holds code.
    """
    content = _read(path)
    if part and isinstance(content, dict):
        content = content.get(part, content)
    import torch

    if not isinstance(content, dict) or not content or not all(isinstance(x, torch.Tensor) for x in content.values()):
        raise InputError(f"{path}: a checkpoint, but not of a network's weights alone; is it the right file?")
    return content


def load_into(
    network: Any,
    path: Path,
    *,
    part: str = "",
    below: str = "",
    may_miss: Collection[str] = (),
    renamed: Callable[[str], str] = str,
) -> None:
    """Load a file's tensors into a network of PyTorch.

    Args:
        network: a `torch.nn.Module`.
        path, part: see `load_state_dict`.
        below: how the names of its tensors begin in a file that holds several networks.
        may_miss: names that the network has and the file need not have: constants.
        renamed: the network's name for a name in the file.

    Raises:
        InputError: see `load_state_dict`; or the tensors are those of another network.
    """
    found = load_state_dict(path, part=part).items()
    tensors = {renamed(name.removeprefix(below)): tensor for name, tensor in found if name.startswith(below)}
    try:
        missing, unexpected = network.load_state_dict(tensors, strict=False)
    except RuntimeError as error:  # shapes that differ
        raise another_network(path, error) from None
    wrong = [*(name for name in missing if name not in may_miss), *unexpected]
    if wrong:
        side = "lacks" if wrong[0] in missing else "holds"
        raise InputError(f"{path}: weights of another network ({side} {wrong[0]}); is it the right file?")


def another_network(path: Path, error: Exception) -> InputError:
    """What to raise when PyTorch finds that weights do not fit, in one line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    detail = lines[1] if len(lines) > 1 else "".join(lines)
    return InputError(f"{path}: weights of another network ({detail[:160].rstrip(':. ')}); is it the right file?")


def _read(path: Path) -> object:
    if not path.is_file():
        raise InputError(f"{path}: there is no such file of weights; check the path")
    if path.suffix == ".safetensors":
        return _read_safetensors(path)
    import torch

    try:
        with warnings.catch_warnings():
            # What is odd about the file is either refused below or of no harm.
            warnings.simplefilter("ignore", UserWarning)
            return torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        if "GLOBAL" in str(error):  # the opcode that asks for something to be imported
            raise InputError(f"{path}: holds code or objects besides numbers, and is not read; get it anew") from None
        raise InputError(f"{path}: not a checkpoint of PyTorch; is it the right file?") from None
    except (RuntimeError, EOFError, OSError, ValueError, KeyError, AttributeError, BadZipFile) as error:
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(f"{path}: cut off, or not a checkpoint of PyTorch ({reason}); fetch it again") from None


def _read_safetensors(path: Path) -> object:
    try:
        from safetensors import SafetensorError
        from safetensors.torch import load_file
    except ImportError as error:
        raise BackendUnavailable(f"{path}: reading it takes a library: pip install safetensors") from error
    try:
        return load_file(path)
    except (SafetensorError, OSError, ValueError) as error:
        raise InputError(f"{path}: cut off, or not a file of safetensors ({error}); fetch it again") from None
