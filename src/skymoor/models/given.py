# SPDX-License-Identifier: Apache-2.0
"""What was read of somebody's model: a surface, cameras and photos, in the coordinates of its own files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skymoor.types import Array, Array32, Component, Image, Mask, Photos

# fmt: off
PartKind = Literal[
    "orthophoto", "dsm", "las", "ply", "e57", "obj", "gltf", "spz",
    "colmap", "nerfstudio", "opensfm", "bundler", "metashape", "realityscan",
]
# fmt: on


@dataclass(frozen=True)
class Part:
    """A file of a model, or for COLMAP its folder.

    All parts of a model share one coordinate system, apart from an `offset` (x, y, z) that is added to those of this
    one.
    """

    kind: PartKind
    path: Path
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points (n, 3) and, where they are known, their colours (n, 3)."""

    points: Array
    colours: Image | None


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles (m, 3) of vertices (n, 3), with colours (n, 3) of the vertices or with textures.

    `uv` (m, 3, 2) are texture positions of each triangle's corners, from 0 to 1 and counted upwards from the lower
    edge; `face_texture` (m,) is the index of each triangle's image in `textures`, -1 for none.
    """

    vertices: Array
    triangles: NDArray[np.int64]
    colours: Image | None = None
    uv: Array32 | None = None
    face_texture: NDArray[np.int32] | None = None
    textures: tuple[Image, ...] = ()

    @property
    def points(self) -> Array:
        """The vertices."""
        return self.vertices

    @property
    def coloured(self) -> bool:
        """Whether anything says how it looks."""
        return self.colours is not None or bool(self.textures)


@dataclass(frozen=True, eq=False)
class Plan:
    """An orthophoto (h, w, 3) with the pixels that it has data in, and heights (h, w) of its DSM if there is one.

    `model_from_px` (2, 3) takes pixels to the coordinates of the file: those of its geotransform where it has a usable
    one, else pixels with y upwards. It is a similarity that does not mirror.
    """

    rgb: Image
    mask: Mask
    heights: Array32 | None
    model_from_px: Array


Surface = Cloud | Mesh | Plan


@dataclass(frozen=True, eq=False)
class GivenModel:
    """A model as its files have it.

    Attributes:
        name: for the user.
        parts: its files, all of which are moved with it.
        surface: what is rendered.
        sparse: whether it is only the tie points of cameras, so that photos show far more, if they are there.
        component, photos: cameras with points and observations, and their photos, both without distortion that
            `Intrinsics` cannot state; no photos where they are not all there.
        up: (3,) unit vector where the format says it, else None.
        unit_m: metres of one unit of its coordinates, where the files say it.
        notes: sentences for the user, one line each.
    """

    name: str
    parts: tuple[Part, ...]
    surface: Surface
    sparse: bool = False
    component: Component | None = None
    photos: Photos | None = None
    up: Array | None = None
    unit_m: float | None = None
    notes: tuple[str, ...] = field(default=())


Z_UP = np.array([0.0, 0.0, 1.0])
Y_UP = np.array([0.0, 1.0, 0.0])
