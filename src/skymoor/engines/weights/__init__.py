# SPDX-License-Identifier: Apache-2.0
"""Pretrained weights: which are known, where they lie, how they come there, and reading them without trust.

Nothing is downloaded unless `fetch` is called, which only the command `skymoor weights fetch` does.
"""

from skymoor.engines.weights.fetch import fetch
from skymoor.engines.weights.files import (
    another_network,
    files_in,
    find,
    load_into,
    load_state_dict,
    sha256_of,
    stamps,
    verify,
    weights_folder,
)
from skymoor.engines.weights.table import KNOWN, WeightFile, Weights, known

__all__ = [
    "KNOWN",
    "WeightFile",
    "Weights",
    "another_network",
    "fetch",
    "files_in",
    "find",
    "known",
    "load_into",
    "load_state_dict",
    "sha256_of",
    "stamps",
    "verify",
    "weights_folder",
]
