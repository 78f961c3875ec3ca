# SPDX-License-Identifier: Apache-2.0
"""An orthophoto in its own pixels, as 8-bit colours."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rasterio.io import DatasetReader
from rasterio.windows import Window

from skymoor.errors import InputError
from skymoor.reference.heights import STATISTICS_PX
from skymoor.reference.raster import MapRaster, block_mean, has_palette, opened, read_colours
from skymoor.types import Image, Mask

Array32 = NDArray[np.float32]

STRETCH_PERCENT = (1.0, 99.0)


@dataclass(frozen=True, eq=False)
class OwnPixels:
    """An open orthophoto; `step` of its pixels along each side are averaged to one."""

    raster: MapRaster
    step: int
    _source: DatasetReader
    _stretch: Callable[[Array32], Array32]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns after averaging; incomplete blocks at the border are left out."""
        rows, columns = self.raster.shape
        return rows // self.step, columns // self.step

    def read(self, rows: slice, columns: slice) -> tuple[Image, Mask]:
        """Colours (h, w, 3) and where they are valid, of averaged pixels."""
        window = Window(
            columns.start * self.step,
            rows.start * self.step,
            (columns.stop - columns.start) * self.step,
            (rows.stop - rows.start) * self.step,
        )
        colours, valid = read_colours(self._source, window)
        every = (self.step, self.step)
        weight = block_mean(valid, every)
        mixed = block_mean(self._stretch(colours) * valid[..., None], every) / np.maximum(weight, 1e-6)[..., None]
        mask = weight >= 0.5
        return np.where(mask[..., None], np.clip(np.rint(mixed), 0, 255), 0).astype(np.uint8), mask


@contextmanager
def own_pixels(path: Path, step: int = 1) -> Iterator[OwnPixels]:
    """Open an orthophoto. Raises `InputError` where it cannot be read or lies nowhere."""
    raster = MapRaster.of(path)
    with opened(path) as source:
        yield OwnPixels(raster, step, source, stretch_of(source, raster))


def stretch_of(source: DatasetReader, raster: MapRaster) -> Callable[[Array32], Array32]:
    """The stretch to 0..255: none for 8 bits, else linear over the middle 98 % of all valid values of all bands."""
    if has_palette(source) or all(kind == "uint8" for kind in source.dtypes):
        return lambda colours: colours
    rows, columns = raster.shape
    step = max(1, rows // STATISTICS_PX), max(1, columns // STATISTICS_PX)
    colours, valid = read_colours(source, Window(0, 0, columns, rows), step)
    if not valid.any():
        raise InputError(f"{raster.path}: the orthophoto has no valid pixel; check its nodata value and mask")
    low, high = (float(value) for value in np.percentile(colours[valid > 0], STRETCH_PERCENT))
    gain = 255.0 / max(high - low, 1e-12)
    return lambda colours: np.clip((colours - low) * gain, 0.0, 255.0).astype(np.float32)
