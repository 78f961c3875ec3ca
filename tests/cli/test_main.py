# SPDX-License-Identifier: Apache-2.0
"""Bad input: one clear line that names the file, exit status 2, and nothing half-written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from affine import Affine

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


def write_raster(path: Path, bands: np.ndarray, *, east: float = 500_000.0, crs: str | None = "EPSG:32617") -> None:
    georeference = {} if crs is None else {"crs": crs, "transform": Affine(0.5, 0, east, 0, -0.5, 3_000_000.0)}
    count, height, width = bands.shape
    profile = {
        "driver": "GTiff",
        "height": height,
        "width": width,
        "count": count,
        "dtype": bands.dtype,
        "nodata": None,
    }
    if bands.dtype == np.float32:
        profile["nodata"] = -9999.0
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile, **georeference) as raster:
            raster.write(bands)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A complete site folder whose photos are noise: good enough to be read."""
    rng = np.random.default_rng(0)
    (tmp_path / "airborne").mkdir()
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"airborne/{k}.png"), rng.integers(0, 255, (48, 64, 3), np.uint8))
    write_raster(tmp_path / "ortho.tif", rng.integers(1, 255, (3, 80, 80), np.uint8))
    write_raster(tmp_path / "dsm.tif", rng.normal(10, 1, (1, 80, 80)).astype(np.float32))
    (tmp_path / "site.toml").write_text(SITE)
    return tmp_path


def empty_folder(site: Path) -> str:
    for file in (site / "airborne").iterdir():
        file.unlink()
    return "airborne"


def truncated_image(site: Path) -> str:
    file = site / "airborne/2.png"
    file.write_bytes(file.read_bytes()[:2000])
    return "2.png"


def two_images(site: Path) -> str:
    for k in (0, 1):
        (site / f"airborne/{k}.png").unlink()
    return "airborne"


def missing_ortho(site: Path) -> str:
    (site / "ortho.tif").unlink()
    return "ortho.tif"


def truncated_dsm(site: Path) -> str:
    file = site / "dsm.tif"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    return "dsm.tif"


def no_overlap(site: Path) -> str:
    write_raster(site / "dsm.tif", np.full((1, 80, 80), 10, np.float32), east=600_000.0)
    return "dsm.tif"


def empty_dsm(site: Path) -> str:
    write_raster(site / "dsm.tif", np.full((1, 80, 80), -9999, np.float32))
    return "dsm.tif"


def no_crs(site: Path) -> str:
    write_raster(site / "ortho.tif", np.full((3, 80, 80), 9, np.uint8), crs=None)
    return "ortho.tif"


def edit(old: str, new: str) -> Callable[[Path], str]:
    def apply(site: Path) -> str:
        (site / "site.toml").write_text(SITE.replace(old, new))
        return new.split()[-1].strip('"') if new else "dsm.tif"

    return apply


CASES = [
    empty_folder,
    truncated_image,
    two_images,
    missing_ortho,
    truncated_dsm,
    no_overlap,
    empty_dsm,
    no_crs,
    edit('vertical_datum = "ellipsoid"', 'vertical_datum = "EPSG:999999"'),
    edit('vertical_datum = "ellipsoid"\n', ""),
    edit('images = "airborne"', 'images = "airborn"'),
    edit("ce90 = 2.5", "ce90 = -1"),
]


@pytest.mark.parametrize("spoil", CASES, ids=lambda case: case.__name__)
def test_bad_input_is_one_line_that_names_the_file(
    spoil: Callable[[Path], str], site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    named = spoil(site)
    assert main(["run", str(site / "site.toml"), "--out", str(site / "out")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and named in lines[0], lines
    assert not (site / "out/summary.json").exists() and not (site / "out/cameras.csv").exists()


@pytest.mark.parametrize("option", ["match.cyclic.cycle_pixels=3", "match.cyclic.cycle_px=wide", "nothing=1"])
def test_misspelt_option(option: str, site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(site / "site.toml"), "--out", str(site / "out"), "--set", option]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and option.split("=")[0].split(".")[-1] in lines[0], lines


def test_misspelt_key_in_site_toml(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (site / "site.toml").write_text(SITE.replace("ortho =", "orto ="))
    assert main(["run", str(site / "site.toml"), "--out", str(site / "out")]) == 2
    line = capsys.readouterr().err
    assert "orto" in line and "ortho" in line and "site.toml" in line


def test_out_is_a_file(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (site / "out").write_text("mine")
    assert main(["run", str(site / "site.toml"), "--out", str(site / "out")]) == 2
    assert str(site / "out") in capsys.readouterr().err
    assert (site / "out").read_text() == "mine"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a file system that nobody may write to")
def test_out_is_not_writable(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(site / "site.toml"), "--out", "/proc/skymoor"]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and "/proc/skymoor" in lines[0]


def test_photos_without_anything_in_common_end_as_not_registered(site: Path) -> None:
    assert main(["run", str(site / "site.toml"), "--out", str(site / "out"), "--quiet"]) == 3
    table = (site / "out/cameras.csv").read_text().splitlines()
    assert len(table) == 5 and all("NOT_REGISTERED" in line for line in table[1:])
    assert not (site / "out/pointcloud.laz").exists()


def test_usage_error_is_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--no-such-flag"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no-such-flag" in line


def test_evaluate_without_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "truth.csv").write_text("image,lat,lon,height\n")
    assert main(["evaluate", str(tmp_path), "--truth", str(tmp_path / "truth.csv")]) == 2
    assert "summary.json" in capsys.readouterr().err
