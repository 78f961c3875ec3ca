# SPDX-License-Identifier: Apache-2.0
"""Sets of photos that cannot be placed, or hold some that cannot; a reference in a mirror; and runs that are killed."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from skymoor.simulate.site import Site
from support.flight import STANDOFF_M, Flight
from support.interrupted import KILLED, run_site, status_of
from support.small_run import arguments, rows_of, run, summary_of

pytestmark = pytest.mark.e2e

Photo = NDArray[np.uint8]
PLACE = ("lat", "lon", "height", "east", "north", "up", "qw", "ce90", "le90")


def copies(flight: Flight) -> list[Photo]:
    return [next(iter(flight.images.values()))] * 6


def turned(flight: Flight) -> list[Photo]:
    """Of one place, by a camera that only turns: any scale and depth explains them."""
    camera = flight.cameras[flight.from_above[0]]
    photo, i = flight.images[camera.image], camera.intrinsics
    k = np.array([[i.fx, 0, i.cx], [0, i.fy, i.cy], [0, 0, 1]])
    turns = Rotation.from_euler("xyz", [(x, y, z) for x in (-4, 4) for y in (-4, 4) for z in (-3, 3)], degrees=True)
    warps = [k @ turn @ np.linalg.inv(k) for turn in turns.as_matrix()]
    inner = (slice(40, -40), slice(50, -50))  # of which every picture shows something
    return [cv2.warpPerspective(photo, warp, (i.width, i.height))[inner] for warp in warps]


def blurred(flight: Flight) -> list[Photo]:
    return [cv2.GaussianBlur(photo, (0, 0), 25.0) for photo in flight.images.values()]


def blank(flight: Flight) -> list[Photo]:
    return [np.full_like(photo, 40 + 10 * k) for k, photo in enumerate(list(flight.images.values())[:6])]


def noise(flight: Flight) -> list[Photo]:
    return [np.random.default_rng(k).integers(0, 256, (300, 400, 3), np.uint8) for k in range(6)]


def site_of(photos: list[Photo], small_site: Site, folder: Path) -> Path:
    """A site.toml of these photos and the small site's reference."""
    (folder / "airborne").mkdir(parents=True)
    for k, photo in enumerate(photos):
        Image.fromarray(photo).save(folder / f"airborne/{k:02d}.png")
    shutil.copytree(small_site.folder / "reference", folder / "reference")
    shutil.copy(small_site.folder / "airborne.toml", folder / "site.toml")
    return folder / "site.toml"


@pytest.mark.parametrize("make", [copies, turned, blurred, blank, noise], ids=lambda make: make.__name__)
def test_what_has_no_depth_is_not_registered(
    make: Callable[[Flight], list[Photo]], flight: Flight, small_site: Site, tmp_path: Path
) -> None:
    photos = make(flight)
    assert run(site_of(photos, small_site, tmp_path / "site"), tmp_path / "out") == 3
    (found,) = summary_of(tmp_path / "out")["sets"]
    assert found["status"] == "NOT_REGISTERED"
    assert found["reason"] or all(component["reason"] for component in found["components"])
    rows = rows_of(tmp_path / "out/cameras.csv")
    assert len(rows) == len(photos)
    assert not any(row[key] for row in rows for key in PLACE)
    assert not (tmp_path / "out/pointcloud.laz").exists()


def test_a_reference_in_a_mirror_is_refused(finished: Path, small_site: Site, tmp_path: Path) -> None:
    out, reference = tmp_path / "out", tmp_path / "site/reference"
    shutil.copytree(finished, out)
    shutil.copytree(small_site.folder / "reference", reference)
    for path in reference.glob("*.tif"):
        with rasterio.open(path, "r+") as raster:
            raster.write(raster.read()[:, :, ::-1])
    photos, toml = small_site.folder / "airborne", small_site.folder / "airborne.toml"
    text = toml.read_text().replace('"airborne"', f'"{photos}"')
    (tmp_path / "site/site.toml").write_text(text)
    assert run(tmp_path / "site/site.toml", out) == 3
    (component,) = summary_of(out)["sets"][0]["components"]
    assert component["status"] == "NOT_REGISTERED" and component["reason"]
    assert not any(row[key] for row in rows_of(out / "cameras.csv") for key in PLACE)


def test_bad_photos_among_good_ones_do_no_harm(
    flight: Flight, finished: Path, small_site: Site, tmp_path: Path
) -> None:
    """A copy of a photo, one without contrast and one out of focus, among sixteen good ones."""
    good = list(flight.images.values())
    bad = [good[5], np.full_like(good[0], 127), cv2.GaussianBlur(good[3], (0, 0), 30.0)]
    run(site_of([*good, *bad], small_site, tmp_path / "site"), tmp_path / "out")
    rows = {int(Path(row["image"]).stem): row for row in rows_of(tmp_path / "out/cameras.csv")}
    alone = {row["image"]: row for row in rows_of(finished / "cameras.csv")}
    for row, name in zip((rows[k] for k in range(len(good))), flight.images, strict=True):
        assert row["status"] == "REGISTERED"
        gaps = [float(row[key]) - float(alone[name][key]) for key in ("east", "north", "up")]
        assert np.linalg.norm(gaps) < 0.015 * STANDOFF_M, name
    copy, plain, soft = (rows[len(good) + k] for k in range(3))
    assert copy["status"] == "REGISTERED"
    assert all(abs(float(copy[key]) - float(rows[5][key])) < 0.3 for key in ("east", "north", "up"))
    assert plain["status"] == soft["status"] == "NOT_REGISTERED"


def test_a_run_killed_again_and_again_ends_with_the_same_bytes(
    finished: Path, small_site: Site, tmp_path: Path
) -> None:
    """From nothing, in another process: so two runs with one seed give the same cameras.csv as well."""
    rng, out, killed = np.random.default_rng(5), tmp_path / "out", 0
    command = arguments(small_site.folder / "airborne.toml", out)
    for patience_s in rng.uniform(1.0, 9.0, 3):
        killed += status_of(run_site, command, tmp_path, patience_s=float(patience_s)) == KILLED
    assert status_of(run_site, command, tmp_path) == 0
    for name in ("cameras.csv", "cameras.geojson", "pointcloud.laz", "dsm.tif", "ortho.tif", "matches/airborne_0.npz"):
        assert (out / name).read_bytes() == (finished / name).read_bytes(), name
    assert not list(out.rglob(".skymoor-*"))
