# SPDX-License-Identifier: Apache-2.0
"""RoMa v2, opt-in: it uses DINOv3, whose licence forbids some uses.

Edstedt et al., RoMa v2: Harder Better Faster Denser Feature Matching, 2025.
"""

from __future__ import annotations

import contextlib
import io
import logging
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from skymoor.engines.libraries import require
from skymoor.engines.weights import another_network, find, load_state_dict
from skymoor.errors import BackendUnavailable, InputError
from skymoor.match.flow import EngineFlow, warp_from_flows
from skymoor.match.protocol import DenseMatcher
from skymoor.types import Raster, Warp

DINOV3 = "facebookresearch_dinov3_adc254450203739c8149213a7a69d8d905b4fcfa"
"""Folder name that the library expects for DINOv3's code; it ends with the required commit."""


@dataclass(frozen=True)
class RomaV2Matcher:
    """RoMa v2: a flow and its overlap for every pixel, in both directions. A GPU is recommended and used if present.

    Attributes:
        accept_dinov3_licence: confirms that you have read the DINOv3 licence (github.com/facebookresearch/dinov3,
            LICENSE.md) and that your use is allowed: military uses and some others are not.
        weights: path of romav2.0.1.pt; empty for where `skymoor weights fetch romav2` puts it.
        dinov3: folder of DINOv3's code at the commit in `DINOV3`, with hubconf.py in it; empty for the folder dinov3
            beside the weights.
        setting: the library's preset, from "turbo" (320 pixels) to "precise" (1280); "satast" is meant for photos of
            the Earth from orbit.
    """

    accept_dinov3_licence: bool = False
    weights: str = ""
    dinov3: str = ""
    setting: Literal["turbo", "fast", "base", "precise", "satast"] = "fast"

    def ready(self) -> tuple[Path, ...]:
        """The file and the folder that will be read; raises as `__call__` where something is missing."""
        if not self.accept_dinov3_licence:
            raise BackendUnavailable(
                "RoMa v2 uses DINOv3, whose licence forbids military and some other uses: "
                "read it, and if your use is allowed, set accept_dinov3_licence = true"
            )
        require("romav2", "romav2")
        weights = find("romav2", "romav2.0.1.pt", self.weights)
        return weights, _code(self.dinov3, weights)

    def __call__(self, a: Raster, b: Raster) -> Warp:
        """Match in both directions; see `DenseMatcher`.

        Raises:
            BackendUnavailable: the licence is not accepted; or romav2, the weights or DINOv3's code are missing.
            InputError: the weights are not RoMa v2's.
        """
        network = _network(*self.ready(), self.setting)
        with warnings.catch_warnings():
            # It requests CUDA half precision, for which PyTorch warns where there is no CUDA.
            warnings.filterwarnings("ignore", message="CUDA is not available", category=UserWarning)
            found = network.match(a.rgb, b.rgb)
        flows = (
            EngineFlow(_numpy(found[f"warp_{way}"][0]), _numpy(found[f"overlap_{way}"][0, ..., 0]))
            for way in ("AB", "BA")
        )
        return warp_from_flows(a, b, *flows)


_: type[DenseMatcher] = RomaV2Matcher


def _code(given: str, weights: Path) -> Path:
    path = Path(given).expanduser() if given else weights.parent / "dinov3"
    if (path / "hubconf.py").is_file():
        return path
    missing = f"DINOv3's code at commit {DINOV3[-40:]} is missing (no hubconf.py)"
    if given:
        raise InputError(f"{path}: {missing}; set dinov3 to its folder")
    raise BackendUnavailable(f"{path}: {missing}; get it from github.com/facebookresearch/dinov3 and unpack it there")


@lru_cache(maxsize=1)
def _network(weights: Path, dinov3: Path, setting: str) -> Any:
    load_state_dict(weights)  # gives a clearer error than the library for an unsuitable file
    romav2 = require("romav2", "romav2")
    logging.getLogger("romav2").setLevel(logging.WARNING)  # stages print nothing
    with _local_hub(weights, dinov3), contextlib.redirect_stderr(io.StringIO()):
        try:
            network = romav2.RoMaV2(romav2.RoMaV2.Cfg(setting=setting))
        except RuntimeError as error:
            if "state_dict" not in str(error):
                raise
            raise another_network(weights, error) from None
    network.bidirectional = True
    return network


@contextlib.contextmanager
def _local_hub(weights: Path, dinov3: Path) -> Iterator[None]:
    """Make both files available to the library, which loads through PyTorch's hub, in a temporary hub folder."""
    import torch

    before = torch.hub.get_dir()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "checkpoints").mkdir()
        (Path(folder) / "checkpoints/romav2.0.1.pt").symlink_to(weights.resolve())
        (Path(folder) / DINOV3).symlink_to(dinov3.resolve(), target_is_directory=True)
        torch.hub.set_dir(folder)
        try:
            yield
        finally:
            torch.hub.set_dir(before)


def _numpy(values: Any) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.asarray(values.float().cpu().numpy(), np.float32)
