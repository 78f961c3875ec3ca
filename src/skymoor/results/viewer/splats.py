# SPDX-License-Identifier: Apache-2.0
"""Gaussian splats that a run has placed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from skymoor.errors import BackendUnavailable, InputError
from skymoor.models.ply import SH_0, is_splat, open_ply
from skymoor.results.placed.move import PLACED
from skymoor.results.read import Result
from skymoor.types import Array, Array32

MAX_SPLATS = 500_000


@dataclass(frozen=True, eq=False)
class Splats:
    """Gaussians: `centres` (n, 3) ENU metres, `covariances` (n, 3, 3) m^2, and `rgb` (n, 3), `opacity` (n, 1) to 1."""

    name: str
    centres: Array32
    covariances: Array32
    rgb: Array32
    opacity: Array32


def splats_of(result: Result) -> Iterator[Splats | str]:
    """Those in the folder `placed` of a run of `skymoor register`, and lines on what cannot be read."""
    for path in sorted((result.folder / PLACED).glob("*.ply")):
        try:
            found = read_splats(path)
        except (InputError, BackendUnavailable) as error:
            yield str(error)
            continue
        if found is not None:
            yield found


def read_splats(path: Path, most: int = MAX_SPLATS) -> Splats | None:
    """Gaussians of a PLY file, the most visible ones where there are more than `most`; None where it has none.

    The colour is that of the mean over all directions. Raises `InputError` where it cannot be read, and
    `BackendUnavailable` without plyfile.
    """
    vertex = open_ply(path)["vertex"].data
    if not is_splat(vertex.dtype.names):
        return None

    def columns(prefix: str, count: int) -> Array:
        return np.column_stack([vertex[f"{prefix}{k}"] for k in range(count)]).astype(np.float64)

    sizes, opacity = np.exp(columns("scale_", 3)), 1 / (1 + np.exp(-vertex["opacity"].astype(np.float64)))
    visible = opacity * np.prod(np.sort(sizes, axis=1)[:, 1:], axis=1)  # seen along its shortest axis
    kept = np.sort(np.argsort(-visible, kind="stable")[:most])
    xyz = np.column_stack([vertex[axis] for axis in "xyz"])[kept]
    turn = Rotation.from_quat(columns("rot_", 4)[kept], scalar_first=True).as_matrix()
    spread = turn * sizes[kept, None, :]
    colours = np.clip(0.5 + SH_0 * columns("f_dc_", 3)[kept], 0, 1)
    arrays = (xyz, spread @ np.swapaxes(spread, 1, 2), colours, opacity[kept, None])
    return Splats(path.stem, *(array.astype(np.float32) for array in arrays))
