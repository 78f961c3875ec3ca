# SPDX-License-Identifier: Apache-2.0
"""What says how high the ground is: a DSM, one height for the whole site, or nothing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from rasterio.io import DatasetReader

from skymoor.errors import InputError
from skymoor.geo import EnuFrame, sample
from skymoor.geo.datum import ToEllipsoid, ellipsoid_from_datum, same_vertical_datum, unit_of_datum
from skymoor.geo.units import unit_m
from skymoor.reference.nodata import HEIGHT_RANGE_M, Sampled, require_declared_nodata, require_on_earth
from skymoor.reference.raster import MapRaster, block_mean, read_heights, window_around
from skymoor.reference.resample import Cut, Lattice

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

STATISTICS_PX = 1000
# Units that differ by less are one: the international and the US survey foot, which many programs confuse.
SAME_UNIT = 1e-5
_HOW_TO_STATE = '"ellipsoid" or to the EPSG code of a vertical CRS, such as "EPSG:3855"'


class Ground(Protocol):
    """Heights of a site. `notes` are sentences about how they were read."""

    @property
    def to_ellipsoid(self) -> ToEllipsoid:
        """From the datum to the ellipsoid, with its accuracy."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about how they were read."""

    def middle_m(self, lat: float, lon: float) -> float:
        """Ellipsoidal height of the site's origin."""

    def tile(self, lattice: Lattice) -> Array32:
        """Up (rows, columns) in metres on a tile of the grid, NaN where it is unknown."""

    def pixel_m(self, frame: EnuFrame) -> float:
        """Side of a pixel of the heights; infinite where they have none."""


@dataclass(frozen=True, eq=False)
class NoHeights:
    """Nothing is known of the heights: the frame lies on the ellipsoid."""

    notes: tuple[str, ...] = ()
    to_ellipsoid: ToEllipsoid = field(default_factory=lambda: ellipsoid_from_datum("ellipsoid", 0.0, 0.0))

    @classmethod
    def beside(cls, ortho: Path) -> NoHeights:
        """With an orthophoto alone."""
        return cls(
            (
                f"{ortho}: it has no elevation model, so heights remain unknown; give one, or the height of the ground "
                "in metres, as reference.dsm or --dsm",
            )
        )

    def middle_m(self, lat: float, lon: float) -> float:
        return 0.0

    def tile(self, lattice: Lattice) -> Array32:
        return np.full(lattice.shape, np.nan, np.float32)

    def pixel_m(self, frame: EnuFrame) -> float:
        return float("inf")


@dataclass(frozen=True, eq=False)
class OneHeight:
    """Level ground at a height in the unit of the datum."""

    height: float
    to_ellipsoid: ToEllipsoid
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, height_m: float, datum: str | None, outline: Array) -> OneHeight:
        """At a height in metres above a datum; `outline` (n, 2) are longitudes and latitudes around the site."""
        if not HEIGHT_RANGE_M[0] <= height_m <= HEIGHT_RANGE_M[1]:
            raise InputError(f"reference.dsm = {height_m:g}: no land is at this height; give metres above the datum")
        if datum is None:
            raise InputError(
                f"reference.dsm = {height_m:g}: nothing says which vertical datum this height has; set "
                f"reference.vertical_datum to {_HOW_TO_STATE}"
            )
        note = f"the reference has one height, {height_m:g} m above {datum}, in place of an elevation model"
        return cls(height_m / unit_of_datum(datum), ellipsoid_from_datum(datum, outline[:, 1], outline[:, 0]), (note,))

    def middle_m(self, lat: float, lon: float) -> float:
        return float(self.to_ellipsoid.heights(lat, lon, [self.height])[0])

    def tile(self, lattice: Lattice) -> Array32:
        return _up_of(self.to_ellipsoid, lattice, self.height).astype(np.float32)

    def pixel_m(self, frame: EnuFrame) -> float:
        return float("inf")


@dataclass(frozen=True, eq=False)
class Dsm:
    """Heights of a raster; `scale` is ellipsoidal metres in the unit of its band."""

    raster: MapRaster
    source: DatasetReader
    to_ellipsoid: ToEllipsoid
    scale: float
    median: float  # in the unit of the band
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, raster: MapRaster, source: DatasetReader, datum: str, outline: Array) -> Dsm:
        """Check the heights within `outline` (n, 2), longitudes and latitudes. Raises `InputError` for any fault."""
        found = cls.unchecked(raster, source, datum, outline)
        window = window_around(raster.px_from_lonlat(outline), raster.shape, (1, 1))
        assert window is not None  # the outline is within the DSM
        step = max(1, int(window.height) // STATISTICS_PX), max(1, int(window.width) // STATISTICS_PX)
        heights = read_heights(source, window, step)
        if not np.isfinite(heights).any():
            raise InputError(
                f"{raster.path}: no valid height where it overlaps the orthophoto (nodata is {source.nodata}); "
                "check the file"
            )
        scale = found.scale
        require_on_earth(raster.path, heights, scale)
        lon, lat = (float(value) for value in outline[0])
        sides_m = np.linalg.norm(raster.pixel_sides_m(EnuFrame(lat, lon, 0.0)), axis=1)
        spacing = float(np.max(sides_m * step[::-1]))
        sampled = Sampled(heights * scale, spacing, source.scales[0] * scale, source.offsets[0] * scale)
        require_declared_nodata(raster.path, source, sampled)
        return replace(found, median=float(np.nanmedian(heights)))

    @classmethod
    def unchecked(cls, raster: MapRaster, source: DatasetReader, datum: str, outline: Array) -> Dsm:
        """Of heights that have been checked before; nothing is read, and the median is not known."""
        _require_heights(source, raster.path)
        unit, notes = _unit(raster, source.units[0], datum)
        to_ellipsoid = ellipsoid_from_datum(datum, outline[:, 1], outline[:, 0])
        lon, lat = (float(value) for value in outline[0])
        at_zero, at_1000 = to_ellipsoid.heights(lat, lon, [0.0, 1000.0])
        scale = unit / unit_of_datum(datum) * float(at_1000 - at_zero) / 1000.0
        return cls(raster, source, to_ellipsoid, scale, float("nan"), notes)

    def middle_m(self, lat: float, lon: float) -> float:
        return float(self.to_ellipsoid.heights(lat, lon, [0.0])[0] + self.scale * self.median)

    def tile(self, lattice: Lattice) -> Array32:
        cut = Cut.of(self.raster, lattice)
        if cut is None:
            return np.full(lattice.shape, np.nan, np.float32)
        heights = read_heights(self.source, cut.window, cut.thin)
        require_on_earth(self.raster.path, heights, self.scale)
        # OpenCV rounds its weights to 1/32 pixel, too coarse for heights.
        own = sample(block_mean(heights, cut.step), np.column_stack([cut.u.ravel(), cut.v.ravel()]))
        up = own.reshape(lattice.shape) * self.scale + _up_of(self.to_ellipsoid, lattice, 0.0)
        return up.astype(np.float32)

    def pixel_m(self, frame: EnuFrame) -> float:
        return self.raster.pixel_m(frame)


def agreed_datum(dsm: MapRaster, stated: str | None) -> str:
    """The vertical datum that a DSM's CRS and the user say. Raises `InputError` where none does, or they differ."""
    if stated is None and dsm.vertical_datum is None:
        raise InputError(
            f"{dsm.path}: nothing says which vertical datum its heights have; set reference.vertical_datum to "
            f"{_HOW_TO_STATE}"
        )
    if stated is not None and dsm.vertical_datum is not None and not same_vertical_datum(stated, dsm.vertical_datum):
        raise InputError(
            f"{dsm.path}: its coordinate reference system says heights are {dsm.vertical_datum}, but "
            f"reference.vertical_datum is {stated}; correct one of them"
        )
    datum = stated if dsm.vertical_datum is None else dsm.vertical_datum
    assert datum is not None
    return datum


def _up_of(to_ellipsoid: ToEllipsoid, lattice: Lattice, height: float) -> Array:
    """Up (rows, columns) in metres of one height of the datum.

    The geoid minus the height of the plane up = 0, which bends away from the ellipsoid, is smooth.
    """
    lat, lon, level = lattice.lla.T
    return lattice.spread(to_ellipsoid.heights(lat, lon, np.full(len(lat), height)) - level)


def _unit(dsm: MapRaster, band: str | None, datum: str) -> tuple[float, tuple[str, ...]]:
    """Metres in the unit of a DSM's heights, and a note where they are not in metres.

    The band's unit counts, without one that of the vertical CRS. Both must agree, except that a datum in metres which
    the user states says what heights refer to, and not their unit.
    """
    own = dsm.vertical_unit_m
    if own is None and (of_datum := unit_of_datum(datum)) != 1.0:
        own = of_datum
    band = (band or "").strip()
    unit = unit_m(band) if band else own or 1.0
    if unit is None:
        raise InputError(
            f"{dsm.path}: its band has heights in the unknown unit {band!r}; set it to one that is known, such as "
            "m, cm, ft or us-ft (gdal_edit -units m)"
        )
    if own is not None and abs(unit / own - 1.0) > SAME_UNIT:
        raise InputError(
            f"{dsm.path}: its band has heights in {band}, but the unit of its vertical CRS is {own:.7g} m; correct "
            "one of them (gdal_edit -units, or -a_srs and reference.vertical_datum)"
        )
    unit = unit if own is None else own
    if unit == 1.0:
        return unit, ()
    return unit, (f"{dsm.path}: heights are converted to metres from units of {unit:.10g} m ({band or 'of its CRS'})",)


def _require_heights(source: DatasetReader, path: Path) -> None:
    if source.count >= 3 and all(kind == "uint8" for kind in source.dtypes):
        raise InputError(f"{path}: has {source.count} bands of 8 bits: an image, not heights; is it the orthophoto?")
    scale, offset = source.scales[0], source.offsets[0]
    if not (np.isfinite(scale) and np.isfinite(offset)) or scale == 0:
        raise InputError(
            f"{path}: its band has scale {scale:g} and offset {offset:g}; correct them (gdal_edit -scale -offset)"
        )
