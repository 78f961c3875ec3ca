# SPDX-License-Identifier: Apache-2.0
"""A site folder that is complete and takes milliseconds: photos of noise, which can be read but not placed."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from PIL import Image

from skymoor.cli.main import main

SITE = """
[reference]
ortho = "ortho.tif"
dsm = "dsm.tif"
vertical_datum = "ellipsoid"
ce90 = 2.5
le90 = 3.8
[airborne]
images = "airborne"
"""
WIDTH_PX, HEIGHT_PX = 64, 48
EAST_M, NORTH_M = 500_000.0, 3_000_000.0


@dataclass(frozen=True)
class Case:
    """One thing spoilt: what is done to the site, and the words that the one line must hold."""

    name: str
    spoil: Callable[[Path], object]
    words: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.name


def picture(seed: int = 0, width: int = WIDTH_PX, height: int = HEIGHT_PX) -> NDArray[np.uint8]:
    """Noise (h, w, 3)."""
    return np.random.default_rng(seed).integers(0, 255, (height, width, 3), np.uint8)


def write_raster(
    path: Path, bands: NDArray[np.generic], *, east: float = EAST_M, crs: str | None = "EPSG:32617"
) -> None:
    """Bands (n, h, w) at half a metre per pixel; without a CRS there is no position either."""
    place = {} if crs is None else {"crs": crs, "transform": Affine(0.5, 0, east, 0, -0.5, NORTH_M)}
    count, height, width = bands.shape
    nodata = -9999.0 if bands.dtype == np.float32 else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        profile = {"driver": "GTiff", "height": height, "width": width, "count": count, "dtype": bands.dtype}
        with rasterio.open(path, "w", **profile, nodata=nodata, **place) as raster:
            raster.write(bands)


def make_site(folder: Path) -> Path:
    """Write four photos, an orthophoto, a DSM and site.toml."""
    rng = np.random.default_rng(0)
    (folder / "airborne").mkdir(parents=True)
    for k in range(4):
        Image.fromarray(picture(k)).save(folder / f"airborne/{k}.png")
    write_raster(folder / "ortho.tif", rng.integers(1, 255, (3, 80, 80), np.uint8))
    write_raster(folder / "dsm.tif", rng.normal(10, 1, (1, 80, 80)).astype(np.float32))
    (folder / "site.toml").write_text(SITE, encoding="utf-8")
    return folder


def content(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def run(site: Path, *more: str, out: str = "out") -> int:
    """The run of a site; its exit status."""
    return main(["run", str(site / "site.toml"), "--out", str(site / out), "--quiet", *more])


def assert_refused(site: Path, case: Case, shown: Callable[[], str], *more: str) -> None:
    """Spoil the site, and see it refused: exit status 2, one line with these words, the user's files as they were."""
    arguments = case.spoil(site)
    before = content(site)
    more = (*more, *arguments) if isinstance(arguments, tuple) else more
    assert run(site, *more) == 2
    lines = shown().strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("skymoor: "), lines
    for word in case.words:
        assert word in lines[0], lines
    after = content(site)
    kept = before.keys() - {"out/run.log"}  # which tells of every run
    assert {name: after.get(name) for name in kept} == {name: before[name] for name in kept}
    assert all(name.startswith(("out/stages/", "out/.lock", "out/run.log")) for name in after.keys() - before.keys()), (
        after.keys()
    )
