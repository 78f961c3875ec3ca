# SPDX-License-Identifier: Apache-2.0
"""Models of other programs, displaced by a known similarity, come back to where the run that made them put them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import plyfile
import pycolmap
import pytest
import rasterio
from rasterio import Affine

import skymoor
from skymoor.geo import EnuFrame
from skymoor.pipeline.option_parser import parse_option
from skymoor.pipeline.site import load_site
from skymoor.results.formats._crs import MapFrame
from skymoor.results.read import Result
from skymoor.simulate.site import Site
from support.examples import example
from support.given_models import (
    LEVEL,
    TILTED,
    cloud_of,
    moved_colmap,
    turned_rasters,
    write_las,
    write_ply,
    write_raster,
)
from support.small_run import OPTIONS, SEED, rows_of, summary_of

pytestmark = pytest.mark.e2e

COARSE = dict(map(parse_option, (*OPTIONS, "match.search.azimuth_step_deg=12", "match.search.scale_step=1.12")))
"""Where the model is searched twice, at every scale."""


def registered(site: Site, model: object, out: Path, **more: Any) -> tuple[Result, list[str]]:
    """The result of a model on the site's reference, and the notes."""
    files, notes = load_site(site.folder / "airborne.toml").reference, []
    options = dict(map(parse_option, OPTIONS))
    common = {"ortho": files.ortho, "dsm": files.dsm, "vertical_datum": files.vertical_datum}
    common |= {"ce90": 2.0, "le90": 3.0, "options": options, "seed": SEED, "note": notes.append}
    return skymoor.register_model(model, out=out, **{**common, **more}), notes


def chart_of(run: Path) -> MapFrame:
    origin = summary_of(run)["enu_origin"]
    with rasterio.open(run / "ortho.tif") as ortho:
        crs = ortho.crs.to_wkt()
    return MapFrame(EnuFrame(origin["lat"], origin["lon"], origin["height"]), crs)


def off_m(placed: Path, true: Affine, run: Path) -> np.ndarray:
    """Distances in metres of the placed pixels of a raster from where they belong."""
    chart = chart_of(run)
    with rasterio.open(placed) as file:
        own, found, size = MapFrame(chart.frame, file.crs.to_wkt()), file.transform, (file.width, file.height)
    px = np.random.default_rng(1).uniform([0, 0], size, (100, 2))
    flat = np.zeros(100)
    at = [np.column_stack([*(transform @ tuple(px.T)), flat]) for transform in (found, true)]
    enu = own.enu_from_map(at[0]) - chart.enu_from_map(at[1])
    return np.asarray(np.hypot(enu[:, 0], enu[:, 1]))


def test_an_orthophoto_without_a_position(finished: Path, small_site: Site, tmp_path: Path) -> None:
    bands, _, true = turned_rasters(finished)
    plain = write_raster(tmp_path / "flight.tif", bands)
    result, notes = registered(small_site, plain, tmp_path / "out")
    (found,) = result.components
    assert result.registered and found.heights == "NOT_CONFIRMED" and found.le90_m is None
    assert found.ce90_m is not None and 2.0 <= found.ce90_m < 2.2
    placed = tmp_path / "out" / "placed" / "flight.tif"
    error = off_m(placed, true, finished)
    assert 0.001 < error.mean() < 0.3 and error.max() < 0.6
    with rasterio.open(placed) as file:
        assert (file.read() == bands).all()  # no pixel is resampled
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG" and file.transform.b != 0
    assert not (tmp_path / "out" / "dsm.tif").exists()  # a plane is no surface
    assert any("heights are not confirmed" in note for note in notes)
    assert (tmp_path / "out" / "report.html").exists()


def test_a_project_of_odm_in_units_of_its_own(
    finished: Path, small_site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the example of the documentation, as WebODM zips it: orthophoto and DSM keep their places in the project."""
    bands, heights, true = turned_rasters(finished)
    unit, known = 0.125, heights > -9999
    grid = (
        Affine.translation(10, 20)
        @ Affine.scale(unit)
        @ Affine.scale(np.hypot(true.a, true.d), -np.hypot(true.a, true.d))
    )
    relative = np.where(known, (heights - heights[known].mean()) * unit, -9999).astype(np.float32)
    for name in ("odm_orthophoto", "odm_dem"):
        (tmp_path / "task" / name).mkdir(parents=True)
    write_raster(tmp_path / "task" / "odm_orthophoto" / "odm_orthophoto.tif", bands, grid)
    write_raster(tmp_path / "task" / "odm_dem" / "dsm.tif", relative[None], grid, nodata=-9999)
    zipped = Path(shutil.make_archive(str(tmp_path / "all"), "zip", tmp_path / "task"))
    files = load_site(small_site.folder / "airborne.toml").reference
    table = tmp_path / "reference.toml"
    lines = [f'ortho = "{files.ortho}"', f'dsm = "{files.dsm}"', f'vertical_datum = "{files.vertical_datum}"']
    table.write_text("\n".join(["[reference]", *lines, "ce90 = 2.0", "le90 = 3.0"]))
    options = dict(map(parse_option, OPTIONS))
    assert example("lay_odm_on_reference").main(zipped, table, tmp_path / "out", options=options, seed=SEED)
    assert capsys.readouterr().out.count(": moved") == 2
    result = skymoor.read(tmp_path / "out" / "result")
    assert result.components[0].heights in ("CONFIRMED", "OFFSET_ONLY")
    project = tmp_path / "out" / "project"
    error = off_m(project / "odm_orthophoto" / "odm_orthophoto.tif", true, finished)
    assert 0.001 < error.mean() < 0.3
    with rasterio.open(project / "odm_dem" / "dsm.tif") as file:
        moved = file.read(1)
    gap = (moved - heights)[known]
    assert 0.001 < np.abs(gap).mean() < 0.5
    assert (moved[~known] == -9999).all()


def test_a_coloured_cloud(finished: Path, small_site: Site, tmp_path: Path) -> None:
    points, colours = cloud_of(finished)
    cloud = write_las(tmp_path / "cloud.las", LEVEL.apply(points - points.mean(axis=0)), colours)
    result, _ = registered(small_site, cloud, tmp_path / "out")
    assert result.registered
    moved = laspy.read(tmp_path / "out" / "placed" / "cloud.laz")
    assert (np.asarray(moved.classification) == np.arange(len(points)) % 7).all()
    assert (np.asarray(moved.red) // 257 == colours[:, 0]).all()
    error = np.asarray(moved.xyz) - points
    assert 0.001 < np.hypot(error[:, 0], error[:, 1]).mean() < 0.3
    assert np.abs(error[:, 2]).mean() < 0.5


def test_a_cloud_that_lies_askew_in_an_unknown_frame(finished: Path, small_site: Site, tmp_path: Path) -> None:
    points, colours = cloud_of(finished)
    cloud = write_ply(tmp_path / "cloud.ply", TILTED.apply(points - points.mean(axis=0)), colours)
    result, _ = registered(small_site, cloud, tmp_path / "out")
    assert result.registered
    vertex = plyfile.PlyData.read(str(tmp_path / "out" / "placed" / "cloud.ply"))["vertex"]
    origin = json.loads((tmp_path / "out" / "placed" / "georeference.json").read_text())["enu_origin"]
    own = MapFrame(EnuFrame(origin["lat"], origin["lon"], origin["height"]), chart_of(finished).crs)
    error = own.map_from_enu(np.column_stack([vertex[axis] for axis in "xyz"])) - points
    assert 0.001 < np.hypot(error[:, 0], error[:, 1]).mean() < 0.3
    assert np.abs(error[:, 2]).mean() < 0.6


def test_a_mirrored_cloud_is_told(finished: Path, small_site: Site, tmp_path: Path) -> None:
    points, colours = cloud_of(finished)
    local = LEVEL.apply(points - points.mean(axis=0)) * [-1.0, 1.0, 1.0]
    with pytest.raises(skymoor.InputError, match=r"mirrored \(left-handed\)") as error:
        registered(small_site, write_las(tmp_path / "cloud.las", local, colours), tmp_path / "out", options=COARSE)
    assert "cloud.las" in str(error.value) and "\n" not in str(error.value)


def test_a_colmap_model_with_its_photos(finished: Path, small_site: Site, tmp_path: Path) -> None:
    model = moved_colmap(finished, tmp_path / "project" / "sparse" / "0")
    result, _ = registered(small_site, tmp_path / "project", tmp_path / "out", photos=small_site.folder)
    assert result.registered
    before = {row["image"]: row for row in rows_of(finished / "cameras.csv")}
    rows = rows_of(tmp_path / "out" / "cameras.csv")
    assert {row["set"] for row in rows} == {"model"} and len(rows) == len(before)
    frame = chart_of(finished).frame
    at = [
        frame.enu_from_lla(*(np.array([float(row[key]) for row in table]) for key in ("lat", "lon", "height")))
        for table in (rows, [before[row["image"]] for row in rows])
    ]
    error = np.linalg.norm(at[0] - at[1], axis=1)
    assert 0.001 < error.mean() < 1.5
    placed = pycolmap.Reconstruction(str(tmp_path / "out" / "placed" / "colmap"))
    own = pycolmap.Reconstruction(str(model))
    assert placed.compute_num_observations() == own.compute_num_observations()
    enu = {image.name: image.projection_center() for image in placed.images.values()}
    table = {row["image"]: [float(row[key]) for key in ("east", "north", "up")] for row in rows}
    assert max(np.linalg.norm(enu[name] - np.array(table[name])) for name in table) < 1e-6
