# SPDX-License-Identifier: Apache-2.0
"""Networks that lie in a folder as a model hub publishes them: read from there alone, and not half."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skymoor.errors import BackendUnavailable, InputError

LIBRARIES = ("transformers", "diffusers")


def describes(folder: Path, file: str = "config.json") -> dict[str, Any]:
    """What a JSON file of the folder says. Raises `InputError` if it is missing or is not JSON."""
    path = folder / file
    if not path.is_file():
        raise InputError(f"{folder}: not the folder of a model, it has no {file}; give the folder that was fetched")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        raise InputError(f"{path}: not JSON, or cut off; fetch the folder again") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: does not describe a model; fetch the folder again")
    return content


def open_model(model: Any, folder: Path, kinds: Collection[str], **options: Any) -> Any:
    """A network of the libraries transformers or diffusers, with all of its weights, for inference.

    Args:
        model: the class, such as `transformers.Dinov2Model`.
        folder: with config.json and the weights; nothing else is read, and nothing is downloaded.
        kinds: what config.json may say that the model is, by its `model_type` or `_class_name`; none for anything.
        options: for `from_pretrained`.

    Raises:
        InputError: the folder has no model, another one, or not all of it. The library itself would fill what is
            missing with random numbers, and go on.
    """
    config = describes(folder)
    kind = config.get("model_type", config.get("_class_name"))
    if kinds and kind not in kinds:
        raise InputError(
            f"{folder}: holds a model of type {kind}, not {' or '.join(sorted(kinds))}; is it the right one?"
        )
    with reading(folder):
        network, found = model.from_pretrained(folder, local_files_only=True, output_loading_info=True, **options)
    learned = {name for name, _ in network.named_parameters()}
    # Constants are made anew; what a network has counted in training is no constant.
    lacking = [x for x in found["missing_keys"] if x in learned or x.endswith(("running_mean", "running_var"))]
    lacking += [str(x[0]) for x in found.get("mismatched_keys", ())]
    if lacking:
        raise InputError(f"{folder}: weights of another network (lacks {sorted(lacking)[0]}); is it the right folder?")
    return network.eval()


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Say in one line what a library of the hub's finds wrong with a folder; and say nothing else.

    Raises:
        InputError: something in the folder is missing, cut off, or of another kind.
        BackendUnavailable: a library is missing that this folder needs.
    """
    try:
        with _silence():
            yield
    except ImportError as error:
        raise BackendUnavailable(f"{folder}: reading it takes a library more ({_line(error)})") from None
    except Exception as error:
        # These libraries and those below them raise a dozen kinds of errors over bad files, some bare Exceptions.
        raise InputError(f"{folder}: cannot be read ({_line(error)}); is it the right folder, and whole?") from None


@contextmanager
def _silence() -> Iterator[None]:
    """No bars and no advice from libraries: a stage prints nothing."""
    loggers = [logging.getLogger(name) for name in (*LIBRARIES, "huggingface_hub")]
    levels = [logger.level for logger in loggers]
    chatter = [sys.modules[f"{name}.utils.logging"] for name in LIBRARIES if f"{name}.utils.logging" in sys.modules]
    bars = [library for library in chatter if library.is_progress_bar_enabled()]
    try:
        for logger in loggers:
            logger.setLevel(logging.CRITICAL)
        for library in bars:
            library.disable_progress_bar()
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
        for library in bars:
            library.enable_progress_bar()


def _line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return (lines[0] if lines else type(error).__name__)[:200].rstrip(":. ")
