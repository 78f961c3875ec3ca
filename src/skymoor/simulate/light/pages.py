# SPDX-License-Identifier: Apache-2.0
"""Texture pages with their mip levels in one flat store, and colours looked up in all of them at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

Array32 = NDArray[np.float32]
Index = NDArray[np.int32]

WHITE = 0
"""The page that every set of pages begins with: white, for things whose colour is their tint."""


@dataclass(eq=False)
class Pages:
    """Pictures in linear light, each with the size of its texels in metres. A page repeats beyond its borders.

    `coated` are the pages that are seen through coated glass, which reflects more than plain glass.
    """

    coated: set[int] = field(default_factory=set)
    _levels: list[list[NDArray[np.uint32]]] = field(default_factory=list)
    _texel_m: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.add(np.ones((2, 2, 3), np.float32), 1.0)

    def add(self, albedo: Array32, texel_m: float) -> int:
        """Take a page (h, w, 3), linear albedo in [0, 1], row 0 at the top; returns its number."""
        levels = []
        while True:
            levels.append(_packed(albedo))
            rows, columns = albedo.shape[:2]
            if max(rows, columns) == 1:
                break
            albedo = cv2.resize(
                albedo, (max(columns // 2, 1), max(rows // 2, 1)), interpolation=cv2.INTER_AREA
            ).reshape(max(rows // 2, 1), max(columns // 2, 1), 3)
        self._levels.append(levels)
        self._texel_m.append(texel_m)
        return len(self._levels) - 1

    def copy(self) -> Pages:
        """The same pages, to which others may be added."""
        other = Pages()
        other._levels, other._texel_m = list(self._levels), list(self._texel_m)
        other.coated = set(self.coated)
        return other

    def colours(self, page: NDArray[np.integer], uv: Array32, footprint_m: Array32) -> Array32:
        """Linear colours (n, 3) on pages (n,) at uv (n, 2) metres, averaged over about `footprint_m` (n,)."""
        t = self._table
        ratio = np.maximum(footprint_m / t.texel_m[page], 1.0)
        level = np.minimum(np.log2(ratio, dtype=np.float32).astype(np.int32), t.n_levels[page] - 1)
        entry = t.first[page] + level
        width, height, offset = t.width[entry], t.height[entry], t.offset[entry]
        x = uv[:, 0] * t.per_m_x[entry] - 0.5
        y = uv[:, 1] * t.per_m_y[entry] - 0.5
        left, top = np.floor(x), np.floor(y)
        dx, dy = (x - left)[:, None], (y - top)[:, None]
        x0, y0 = np.mod(left.astype(np.int32), width), np.mod(top.astype(np.int32), height)
        x1, y1 = np.where(x0 + 1 == width, 0, x0 + 1), np.where(y0 + 1 == height, 0, y0 + 1)
        row0, row1 = offset + y0 * width, offset + y1 * width
        upper = _unpacked(t.texels[row0 + x0]) * (1 - dx) + _unpacked(t.texels[row0 + x1]) * dx
        lower = _unpacked(t.texels[row1 + x0]) * (1 - dx) + _unpacked(t.texels[row1 + x1]) * dx
        return np.asarray(np.square(upper * (1 - dy) + lower * dy), dtype=np.float32)

    @cached_property
    def _table(self) -> _Table:
        """The flat store; pages may not be added after the first look."""
        flat = [level for levels in self._levels for level in levels]
        sizes = np.array([level.size for level in flat])
        count = np.array([len(levels) for levels in self._levels], dtype=np.int32)
        full_w = np.repeat([levels[0].shape[1] for levels in self._levels], count)
        full_h = np.repeat([levels[0].shape[0] for levels in self._levels], count)
        texel = np.repeat(self._texel_m, count)
        width = np.array([level.shape[1] for level in flat], dtype=np.int32)
        height = np.array([level.shape[0] for level in flat], dtype=np.int32)
        return _Table(
            texels=np.concatenate([level.ravel() for level in flat]),
            offset=np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int32),
            width=width,
            height=height,
            per_m_x=(width / (full_w * texel)).astype(np.float32),
            per_m_y=(height / (full_h * texel)).astype(np.float32),
            first=np.concatenate([[0], np.cumsum(count)[:-1]]).astype(np.int32),
            n_levels=count,
            texel_m=np.array(self._texel_m, dtype=np.float32),
        )


@dataclass(frozen=True, eq=False)
class _Table:
    """Per level: place in `texels`, size, texels per metre; per page: first level, number of levels, texel size."""

    texels: NDArray[np.uint32]
    offset: Index
    width: Index
    height: Index
    per_m_x: Array32
    per_m_y: Array32
    first: Index
    n_levels: Index
    texel_m: Array32


def _packed(albedo: Array32) -> NDArray[np.uint32]:
    """Three roots of albedo in one number: 8 bits are enough for the eye, and one gather fetches a texel."""
    grey = (np.sqrt(np.clip(albedo, 0, 1)) * 255 + 0.5).astype(np.uint32)
    return np.asarray(grey[..., 0] | (grey[..., 1] << 8) | (grey[..., 2] << 16), dtype=np.uint32)


def _unpacked(texels: NDArray[np.uint32]) -> Array32:
    """Roots of albedo (n, 3)."""
    grey = texels.view(np.uint8).reshape(-1, 4)[:, :3]
    return grey * np.float32(1 / 255)
