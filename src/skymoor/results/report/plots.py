# SPDX-License-Identifier: Apache-2.0
"""A finished run as figures of plotly, for notebooks: `figure.show()`, or `figure.write_html(path)`."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from html import escape
from typing import Any

import cv2
import numpy as np

from skymoor.engines.libraries import require
from skymoor.errors import InputError
from skymoor.results.mosaic import Mosaic, mosaic_of
from skymoor.results.read import Result
from skymoor.results.tables import CameraRow

AXES = ("east", "north", "up")
FAINT, SOLID = 110, 255  # the reference, and the model that lies on it
COMPUTED, KEPT = "#2a6f97", "#b8c4cc"
HOVER = "<b>%{customdata[0]}</b><br>east %{x:.2f} m, north %{y:.2f} m, %{customdata[1]}<extra></extra>"


def plot_cameras(result: Result) -> Any:
    """The cameras from above in metres of the site, on the run's orthophoto and the reference where these are there.

    Returns:
        A `plotly.graph_objects.Figure` with one trace for each registered component, in the order of cameras.csv.

    Raises:
        BackendUnavailable: plotly is not installed.
    """
    go = require("plotly.graph_objects", "plot")
    figure = go.Figure()
    for name, rows in _placed(result).items():
        figure.add_scatter(
            x=[row.east for row in rows],
            y=[row.north for row in rows],
            customdata=[(escape(row.image), _accuracy(row)) for row in rows],
            name=escape(name),
            mode="markers",
            marker={"size": 9, "line": {"width": 1, "color": "white"}},
            hovertemplate=HOVER,
        )
    site = escape(str(result.summary.get("site", "")))
    figure.update_layout(
        title={"text": f"{site}: {len(result.registered_cameras)} of {len(result.cameras)} cameras have a position"},
        xaxis={"title": {"text": "east, m"}, "constrain": "domain"},
        yaxis={"title": {"text": "north, m"}, "scaleanchor": "x", "scaleratio": 1},
        images=list(_background(mosaic_of(result))),
        showlegend=True,
    )
    return figure


def plot_residuals(result: Result) -> Any:
    """Histograms of what the transforms leave at the matches that agree: east, north and up in metres.

    Returns:
        A `plotly.graph_objects.Figure` with three traces for each component that was matched.

    Raises:
        BackendUnavailable: plotly is not installed.
        InputError: the run has no residuals.
    """
    subplots = require("plotly.subplots", "plot")
    found = {one.name: metres for one in result.components if (metres := result.residuals(one)) is not None}
    if not found:
        raise InputError(f"{result.folder / 'matches'}: there are no residuals; run skymoor run again")
    figure = subplots.make_subplots(1, 3, subplot_titles=[f"{axis}, m" for axis in AXES])
    for name, metres in found.items():
        for k, axis in enumerate(AXES):
            label = f"{name} {axis}: median {np.median(metres[:, k]):+.2f} m"
            figure.add_histogram(x=metres[:, k], name=escape(label), opacity=0.7, nbinsx=60, row=1, col=k + 1)
    figure.update_layout(title={"text": "residuals of the matches that agree"}, barmode="overlay")
    return figure


def plot_stages(result: Result) -> Any:
    """The run's stages one after the other, in seconds; those that were kept from a former run are grey.

    Returns:
        A `plotly.graph_objects.Figure` with one trace, a bar for each stage.

    Raises:
        BackendUnavailable: plotly is not installed.
    """
    go = require("plotly.graph_objects", "plot")
    stages = result.summary.get("stages", [])
    seconds = np.array([one["seconds"] for one in stages], dtype=np.float64)
    figure = go.Figure()
    figure.add_bar(
        orientation="h",
        y=[one["name"] for one in stages],
        x=seconds,
        base=np.cumsum(seconds) - seconds,
        customdata=[(one["seconds"], one["peak_mib"]) for one in stages],
        marker={"color": [KEPT if one["cached"] else COMPUTED for one in stages]},
        hovertemplate="<b>%{y}</b><br>%{customdata[0]:.1f} s, at most %{customdata[1]:.0f} MiB<extra></extra>",
    )
    figure.update_layout(
        title={"text": f"{seconds.sum():.0f} s in {len(stages)} stages"},
        xaxis={"title": {"text": "seconds since the start"}},
        yaxis={"autorange": "reversed"},
    )
    return figure


def _placed(result: Result) -> dict[str, list[CameraRow]]:
    """The cameras with a position, by component."""
    found: dict[str, list[CameraRow]] = {}
    for row in result.registered_cameras:
        found.setdefault(f"{row.set}_{row.component}", []).append(row)
    return found


def _accuracy(row: CameraRow) -> str:
    known = [("up", row.up), ("CE90", row.ce90), ("LE90", row.le90)]
    return ", ".join(f"{name} {value:.2f} m" for name, value in known if value is not None)


def _background(mosaic: Mosaic) -> Iterator[dict[str, Any]]:
    """The model on the reference, which is faint, as one image in metres."""
    if mosaic.grid is None:
        return
    rgba = np.zeros((*mosaic.grid.shape, 4), np.uint8)
    if mosaic.satellite is not None:
        rgba[..., :3], rgba[..., 3] = mosaic.satellite, FAINT
    if mosaic.model is not None and mosaic.model_mask is not None:
        rgba[mosaic.model_mask, :3], rgba[mosaic.model_mask, 3] = mosaic.model[mosaic.model_mask], SOLID
    if not rgba[..., 3].any():
        return
    png = cv2.imencode(".png", cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA))[1].tobytes()
    west, south, east, north = mosaic.grid.bounds
    yield {
        "source": f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}",
        **{"xref": "x", "yref": "y", "x": west, "y": north, "sizex": east - west, "sizey": north - south},
        **{"sizing": "stretch", "layer": "below"},
    }
