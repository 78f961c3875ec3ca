# SPDX-License-Identifier: Apache-2.0
"""The surface from above as 3D Tiles with levels of detail: a quadtree of glTF meshes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.geo import EnuFrame
from skymoor.results.formats.gltf import ecef_from_enu, height_field, mesh_glb, origin_of
from skymoor.types import Array, Image, Mask

CELLS = 128  # along the side of a tile, whatever its level
FLATTEST_M = 0.01  # half the height of a box: a box without volume is none


@dataclass(frozen=True, eq=False)
class Surface:
    """A lattice of positions (h, w, 3) in ENU metres, rows going south, its colours (h, w, 3) and where it is known."""

    points: Array
    colours: Image
    known: Mask

    @property
    def spacing_m(self) -> float:
        """Distance of neighbours in plan."""
        return float(np.linalg.norm(self.points[0, 1, :2] - self.points[0, 0, :2]))

    @property
    def levels(self) -> int:
        """How many times a tile of `CELLS` must double to cover all."""
        return max(0, int(np.ceil(np.log2((max(self.known.shape) - 1) / CELLS))))

    def coarsened(self, step: int) -> Surface:
        """Every `step`-th node; colours are means of the known ones around it, since single ones would flicker."""
        if step == 1:
            return self
        weight = cv2.blur(self.known.astype(np.float32), (step, step))[::step, ::step]
        total = cv2.blur(np.where(self.known[..., None], self.colours, 0).astype(np.float32), (step, step))
        mean = np.rint(total[::step, ::step] / np.maximum(weight, 1e-6)[..., None]).clip(0, 255).astype(np.uint8)
        return Surface(self.points[::step, ::step], mean, self.known[::step, ::step])


@dataclass(frozen=True, eq=False)
class _Tile:
    described: dict[str, object]
    low: Array
    high: Array


def write_tiles(surface: Surface, frame: EnuFrame, write: Callable[[str, bytes], None]) -> dict[str, object] | None:
    """The tileset.json (3D Tiles 1.1) of a surface; `write` is given the name and the content of each .glb.

    A tile has at most 128 x 128 cells and is replaced by four of half the spacing. Its geometric error is the spacing
    of its nodes in metres, 0 for the finest, so it halves at each level. Borders have skirts as high as that error,
    since neighbours of another level do not fit exactly. The root's transform is ECEF-from-ENU, columns first, and
    boxes are in ENU metres. None where nothing is known.
    """
    pyramid = [surface.coarsened(2 ** (surface.levels - level)) for level in range(surface.levels + 1)]
    root = _tile(pyramid, (0, 0, 0), frame, write)
    if root is None:
        return None
    described = {"transform": ecef_from_enu(frame).T.ravel().tolist(), **root.described}
    size = float(np.linalg.norm(root.high - root.low))
    return {"asset": {"version": "1.1", "extras": origin_of(frame)}, "geometricError": size, "root": described}


def _tile(
    pyramid: list[Surface], place: tuple[int, int, int], frame: EnuFrame, write: Callable[[str, bytes], None]
) -> _Tile | None:
    """The tile at (level, row, column) with all below it; None where nothing is known."""
    level, row, column = place
    surface, finest = pyramid[level], level == len(pyramid) - 1
    rows, columns = (slice(k * CELLS, (k + 1) * CELLS + 1) for k in (row, column))
    if min(surface.known[rows, columns].shape, default=0) < 2:  # beyond the border, which a single line does not cross
        return None
    part = Surface(surface.points[rows, columns], surface.colours[rows, columns], surface.known[rows, columns])
    spacing = pyramid[-1].spacing_m * 2 ** (len(pyramid) - 1 - level)
    content = _content(part, spacing, f"{level}_{row}_{column}.glb", frame, write)
    below = [(level + 1, 2 * row + k, 2 * column + j) for k in (0, 1) for j in (0, 1)]
    children = [one for child in ([] if finest else below) if (one := _tile(pyramid, child, frame, write))]
    boxes = [*children, *([content] if content else [])]
    if not boxes:
        return None
    low, high = np.min([one.low for one in boxes], axis=0), np.max([one.high for one in boxes], axis=0)
    described: dict[str, object] = {
        "boundingVolume": {"box": _box(low, high)},
        "geometricError": spacing if children else 0.0,
        "refine": "REPLACE",
        **(content.described if content else {}),
        **({"children": [one.described for one in children]} if children else {}),
    }
    return _Tile(described, low, high)


def _content(
    part: Surface, skirt_m: float, name: str, frame: EnuFrame, write: Callable[[str, bytes], None]
) -> _Tile | None:
    points = np.pad(part.points, ((1, 1), (1, 1), (0, 0)), mode="edge")
    ring = np.pad(np.zeros(part.known.shape), 1, constant_values=skirt_m)
    points[..., 2] -= ring
    used, faces = height_field(points, np.pad(part.known, 1, mode="edge"))
    if not len(faces):
        return None
    vertices = points.reshape(-1, 3)[used]
    colours = np.pad(part.colours, ((1, 1), (1, 1), (0, 0)), mode="edge").reshape(-1, 3)[used]
    write(name, mesh_glb(vertices, colours, faces, frame))
    return _Tile({"content": {"uri": name}}, vertices.min(axis=0), vertices.max(axis=0))


def _box(low: Array, high: Array) -> list[float]:
    half = np.diag(np.maximum((high - low) / 2, FLATTEST_M))
    return [*((low + high) / 2).tolist(), *half.ravel().tolist()]
