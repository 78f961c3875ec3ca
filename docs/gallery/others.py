# SPDX-License-Identifier: Apache-2.0
"""Pictures of what is seen outside of skymoor's own pages: a result in a notebook, and a project of ODM on the map."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from PIL import Image
from rasterio.transform import Affine

from gallery.browser import tab
from gallery.pages import beside
from gallery.run import Missing, Source, saved
from skymoor.models.odm import DSM, ORTHO
from skymoor.results.mosaic import Mosaic, mosaic_of
from skymoor.results.read import Result
from skymoor.results.report.scale import with_scale

CELL = """<!doctype html><meta charset="utf-8"><style>body {{ margin: 18px; font: 14px/1.5 sans-serif }}
pre {{ background: #f5f5f5; border: 1px solid #ddd; padding: 8px; font-size: 13px }}
table {{ border-collapse: collapse }} td, th {{ padding: 3px 10px; text-align: right }}</style>
<pre>import skymoor\n\nskymoor.read("result")</pre>{output}"""
"""The look of a notebook's cell; its output is what a notebook shows."""
OFF_M, FIELD_PX = (14.0, -9.0), 60  # an error such as of a drone's GPS, and the squares


def notebook(source: Source, path: Path) -> None:
    """What a result shows of itself as the last line of a cell."""
    page_file = source.scratch / "notebook.html"
    page_file.write_text(CELL.format(output=source.result._repr_html_()), encoding="utf-8")
    with tab() as page:
        page.resize(900, 700)
        page.open(page_file.resolve().as_uri())
        page.until("document.querySelectorAll('.plotly').length > 0")
        page.resize(900, int(page.run("document.documentElement.scrollHeight")))
        page.run("new Promise(done => setTimeout(done, 2000))")  # until the map is drawn
        saved(page.picture(), path, 900)


def odm(source: Source, path: Path) -> None:
    """An orthophoto in ODM's layout a few metres off, and where `skymoor register` lays it, on the reference."""
    project, out = source.scratch / "farm", source.scratch / "farm_placed"
    for name, file in ((ORTHO[0], "ortho.tif"), (DSM[0], "dsm.tif")):
        _moved(source.folder / file, project / name)
    with source.site.open("rb") as text:
        reference = tomllib.load(text)["reference"]
    command = [sys.executable, "-m", "skymoor", "register", str(project), "--out", str(out), "--accuracy", "unknown"]
    for option, name in (("--ortho", "ortho"), ("--dsm", "dsm")):
        command += [option, str(source.site.parent / reference[name])]
    command += ["--vertical-datum", reference["vertical_datum"]]
    done = subprocess.run(command, capture_output=True, check=False, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: status {done.returncode}: {done.stderr}")
    before, after = mosaic_of(source.result), mosaic_of(Result.read(out))
    saved(beside([_fields(before, OFF_M), _fields(after, (0.0, 0.0))]), path, 1200)


def _moved(file: Path, to: Path) -> None:
    """A copy of a raster of the run, a few metres off."""
    if not file.is_file():
        raise Missing(f"the run has no {file.name}")
    to.parent.mkdir(parents=True, exist_ok=True)
    with rasterio.open(file) as raster:
        profile = raster.profile | {"transform": Affine.translation(*OFF_M) * raster.transform, "driver": "GTiff"}
        with rasterio.open(to, "w", **profile) as copy:
            copy.write(raster.read())


def _fields(mosaic: Mosaic, moved_m: tuple[float, float]) -> Image.Image:
    """Model and reference in alternate squares, where there is a model."""
    if mosaic.grid is None or mosaic.satellite is None or mosaic.model is None or mosaic.model_mask is None:
        raise Missing(mosaic.note)
    pixel = mosaic.grid.pixel_m
    by = np.array([[1, 0, moved_m[0] / pixel], [0, 1, -moved_m[1] / pixel]])
    size = mosaic.model_mask.shape[::-1]
    model, mask = (cv2.warpAffine(one, by, size) for one in (mosaic.model, mosaic.model_mask.astype(np.uint8)))
    shown = (mask > 0) & _squares(mask.shape)
    picture = np.where(shown[..., None], model, mosaic.satellite).astype(np.uint8)
    return Image.fromarray(with_scale(picture, pixel))


def _squares(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    rows, columns = np.indices(shape) // FIELD_PX
    return np.asarray((rows + columns) % 2 == 0)
