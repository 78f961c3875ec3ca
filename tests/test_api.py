# SPDX-License-Identifier: Apache-2.0
"""skymoor as notebooks and scripts use it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import geopandas
import numpy as np
import pytest
from rasterio import Affine
from scipy.spatial.transform import Rotation

import skymoor
from skymoor.api import site_of
from skymoor.geometry import Similarity
from skymoor.match import SearchOptions
from skymoor.pipeline.option_parser import parse_option
from skymoor.simulate.site import Site
from skymoor.types import Raster
from support.blocks import ground_points, observed, ring
from support.finished import finished_run
from support.given_models import write_las, write_raster
from support.pictures import noise_picture
from support.small_run import FASTER, SEED, rows_of
from support.tiny_site import make_site

HEAVY = {"torch", "pycolmap", "open3d", "rasterio", "laspy", "plotly", "jinja2", "pandas", "PIL"}


def loaded_by(code: str) -> set[str]:
    """Modules, and parts of SciPy, in a new interpreter after some code."""
    ask = f"import sys\n{code}\nprint(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    names = set(done.stdout.splitlines()[-1].split())
    assert "skymoor" in names
    return {name for name in names if "." not in name or name.startswith("scipy.")}


def test_importing_costs_nothing() -> None:
    assert loaded_by("import skymoor").isdisjoint(HEAVY | {"numpy", "cv2", "scipy"})


def test_a_result_is_read_without_what_made_it(tmp_path: Path) -> None:
    run = finished_run(tmp_path)
    loaded = loaded_by(f"import skymoor; result = skymoor.read({str(run)!r}); repr(result); len(result.cameras)")
    assert loaded.isdisjoint(HEAVY | {"scipy.stats", "scipy.optimize", "scipy.spatial"})


@pytest.mark.parametrize("module", ["skymoor.cli.main", "skymoor.evaluate"])
def test_help_and_evaluation_load_little(module: str) -> None:
    assert loaded_by(f"import {module}").isdisjoint(HEAVY | {"scipy.stats", "scipy.optimize", "scipy.spatial"})


@pytest.mark.parametrize("first", ["", "import skymoor.pipeline.airborne;", "from skymoor.registration import decide;"])
def test_public_names_do_not_depend_on_what_was_imported_before(first: str) -> None:
    ask = f"{first}import skymoor; print(skymoor.register.__module__, skymoor.lift.__module__)"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["skymoor.api", "skymoor.registration.lift"]


def test_what_is_public_is_listed_and_documented() -> None:
    public = {"register", "read", "read_reference", "match_rasters", "lift", "render_nadir", "Result", "InputError"}
    assert public | {"render_orthophoto"} <= set(dir(skymoor))
    assert dir(skymoor) == sorted(dir(skymoor)) == sorted(skymoor.__all__)
    assert all(getattr(skymoor, name).__doc__ for name in dir(skymoor) if name != "__version__")
    with pytest.raises(AttributeError, match="no attribute 'rigister'"):
        skymoor.rigister  # noqa: B018


@pytest.mark.e2e
def test_register_is_the_program(
    finished: Path, small_site: Site, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """It continues a run of the command line with the same data and options, and prints nothing."""
    out = shutil.copytree(finished, tmp_path / "out")
    options = {**dict(map(parse_option, FASTER[1::2])), "match": {"decoys": {"count": np.int64(2)}}}
    (nadir,) = out.glob("stages/airborne-0.nadir-*.npz")
    nadir.unlink()
    seen: list[tuple[str, int, int, str]] = []
    result = skymoor.register(
        small_site.folder / "airborne.toml",
        out=str(out),
        options=options,
        seed=SEED,
        progress=lambda *step: seen.append(step),
    )
    assert result.registered and result.components[0].summary["n_cameras"] == 16
    # The render comes out as it was, so that what depends on it stays.
    assert [stage["name"] for stage in result.summary["stages"] if not stage["cached"]] == ["airborne-0.nadir"]
    assert rows_of(out / "cameras.csv") == rows_of(finished / "cameras.csv")
    assert {name for name, *_, unit in seen if unit != "from the cache"} == {"nadir view", "products"}
    assert all(0 <= done <= total for _, done, total, _ in seen)
    assert capfd.readouterr() == ("", "")


def test_a_site_by_its_data(tmp_path: Path) -> None:
    folder = make_site(tmp_path)
    site = site_of(
        **{"airborne": str(folder / "airborne"), "ortho": folder / "ortho.tif", "dsm": folder / "dsm.tif"},
        **{"vertical_datum": "ellipsoid", "ce90": 2.1, "le90": 3.8},
    )
    assert site.airborne == (folder / "airborne",) and site.ground == () and site.reference.dsm == folder / "dsm.tif"
    assert site_of(site) is site
    with pytest.raises(skymoor.InputError, match="already names the data: leave out --dsm"):
        site_of(folder / "site.toml", dsm=folder / "dsm.tif")


def test_wrong_input_is_an_error_of_one_line(tmp_path: Path) -> None:
    with pytest.raises(skymoor.InputError, match=r"none\.toml: there is no such file"):
        skymoor.register(tmp_path / "none.toml", out=tmp_path / "out")
    site = make_site(tmp_path) / "site.toml"
    with pytest.raises(skymoor.InputError, match=r"match\.candidates"):
        skymoor.register(site, out=tmp_path / "out", options={"match.candidates": {1}})
    with pytest.raises(skymoor.InputError, match=r"match\.sed.*match\.search"):
        skymoor.register(site, out=tmp_path / "out", options={"match.sed": 1})
    with pytest.raises(skymoor.InputError, match="is not the folder of a finished run"):
        skymoor.read(tmp_path)
    assert not (tmp_path / "out").exists()


def test_two_rasters_are_matched() -> None:
    """A known scale, rotation and offset come back, and so do pixels; an unrelated raster is not significant."""
    picture = cv2.GaussianBlur(noise_picture((180, 190)), (0, 0), 1.5)
    scale, azimuth = 0.8, np.radians(40.0)
    turn = scale * np.array([[np.cos(azimuth), -np.sin(azimuth)], [np.sin(azimuth), np.cos(azimuth)]])
    offset = np.array([95.0, 30.0])
    shape = (100, 100)
    # OpenCV counts from the centre of the first pixel.
    matrix = np.column_stack([turn, offset + turn @ [0.5, 0.5] - 0.5])
    part = cv2.warpAffine(picture, matrix, shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    a, b = (Raster(image, np.ones(image.shape[:2], bool)) for image in (part, picture))
    options = SearchOptions(template_px=64, reference_px=160, keep=4)
    found = skymoor.match_rasters(a, b, min_scale=0.75, max_scale=0.85, options=options)
    assert found.scale == pytest.approx(scale, rel=0.01)
    assert found.azimuth_deg == pytest.approx(40.0, abs=0.7)
    corners = np.array([[0.0, 0.0], [100, 0], [0, 100], [100, 100]])
    truth = corners @ turn.T + offset
    assert np.abs(corners @ found.b_from_a[:, :2].T + found.b_from_a[:, 2] - truth).max() < 2
    gaps = np.linalg.norm(found.matches.px_a @ turn.T + offset - found.matches.px_b, axis=1)
    assert len(gaps) > 500 and np.median(gaps) < 0.5
    assert found.false_alarm_probability < 1e-3
    assert max(found.null_scores) < 0.7 * found.score


def test_two_rasters_of_different_sizes_do_not_match() -> None:
    small, large = (Raster(noise_picture((n, n)), np.ones((n, n), bool)) for n in (40, 300))
    with pytest.raises(skymoor.SkymoorError, match="too small"):
        skymoor.match_rasters(large, small, min_scale=0.9, max_scale=1.0)


def test_an_orthophoto_is_a_render_in_its_own_units(tmp_path: Path) -> None:
    rgb, heights = noise_picture((60, 80)), np.full((60, 80), 7.5, np.float32)
    heights[20:30, 40:50] = 9.0
    grid = Affine(0.25, 0, 100.0, 0, -0.25, 50.0)
    ortho = write_raster(tmp_path / "a.tif", rgb.transpose(2, 0, 1), grid)
    render = skymoor.render_orthophoto(ortho, write_raster(tmp_path / "b.tif", heights[None], grid))
    assert render.view.pixel == 0.25 and np.array_equal(render.rgb, rgb)
    np.testing.assert_allclose(render.xyz[30, 40], [0.125, -0.125, 0.0], atol=1e-6)  # beside the middle, on the ground
    np.testing.assert_allclose(render.xyz[25, 45], [1.375, 1.125, 1.5], atol=1e-6)
    assert not np.nan_to_num(skymoor.render_orthophoto(ortho).xyz[..., 2]).any()  # without heights, a plane
    with pytest.raises(skymoor.InputError, match=r"none\.tif"):
        skymoor.render_orthophoto(tmp_path / "none.tif")
    points = np.random.default_rng(0).uniform(0, 50, (4000, 3)) * [1, 1, 0.1]
    with pytest.raises(skymoor.InputError, match=r"cloud\.las: is no orthophoto"):
        skymoor.render_orthophoto(write_las(tmp_path / "cloud.las", points))


def test_a_component_is_levelled() -> None:
    component = observed(ring(), ground_points(600, relief_m=0.3), noise_px=0.2)
    tilted = Similarity(1.0, Rotation.from_euler("xyz", [140, 30, 10], degrees=True).as_matrix(), np.zeros(3))
    level = skymoor.level_component(component.transformed(tilted))
    normal = np.linalg.svd(level.points - level.points.mean(axis=0))[2][2]
    assert abs(normal[2]) > np.cos(np.radians(0.7))
    assert level.centres[:, 2].mean() > level.points[:, 2].mean()


def test_a_result_in_a_few_lines(tmp_path: Path) -> None:
    text = repr(skymoor.read(finished_run(tmp_path)))
    lines = text.splitlines()
    assert len(lines) == 4
    assert lines[1].strip() == "airborne_0: REGISTERED, 9 cameras, CE90 2.10 m, LE90 3.80 m"
    assert lines[2].strip() == "ground0_0: NOT_REGISTERED, no wall fits"


def test_cameras_as_tables(tmp_path: Path) -> None:
    result = skymoor.read(finished_run(tmp_path))
    table = result.to_dataframe()
    assert len(table) == len(result.cameras) == 10
    assert list(table["image"]) == [row.image for row in result.cameras]
    assert table["ce90"].notna().sum() == 9
    points = result.to_geodataframe()
    assert isinstance(points, geopandas.GeoDataFrame) and points.crs.to_epsg() == 4979
    first = result.cameras[0]
    assert (points.geometry.iloc[0].x, points.geometry.iloc[0].y) == (first.lon, first.lat)
    assert points.geometry.iloc[0].z == first.height
    assert points.geometry.iloc[-1] is None


def test_tables_name_the_library_that_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = skymoor.read(finished_run(tmp_path))
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(skymoor.BackendUnavailable, match=r'pip install "skymoor\[table\]"'):
        result.to_dataframe()
