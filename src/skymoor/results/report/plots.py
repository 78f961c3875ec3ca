# SPDX-License-Identifier: Apache-2.0
"""A finished run as figures of plotly, for notebooks: `figure.show()`, or `figure.write_html(path)`."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import replace
from html import escape
from typing import Any

import cv2
import numpy as np

from skymoor.engines.libraries import require
from skymoor.errors import InputError
from skymoor.results.mosaic import Mosaic, mosaic_of
from skymoor.results.read import Result
from skymoor.results.tables import CameraRow
from skymoor.types import Array

AXES = ("east", "north", "up")
FAINT, SOLID = 110, 255  # the reference, and the model that lies on it
COMPUTED, KEPT = "#2a6f97", "#b8c4cc"
CORNERS = 32  # of a circle
CIRCLE: dict[str, Any] = {
    "mode": "lines",
    "name": "CE90",
    "line": {"width": 2, "color": "#d1495b"},
    "hoverinfo": "skip",
}
HOVER = "<b>%{customdata[0]}</b><br>east %{x:.2f} m, north %{y:.2f} m, %{customdata[1]}<extra></extra>"
HOVER_ON_BASEMAP = "<b>%{customdata[0]}</b><br>%{lat:.6f}, %{lon:.6f}, %{customdata[1]}<extra></extra>"


def plot_cameras(result: Result, *, basemap: bool = False) -> Any:
    """The cameras from above with their CE90 circles, on the run's orthophoto.

    Args:
        result: of the run.
        basemap: lay them on OpenStreetMap, whose tiles the browser fetches. Without it nothing is fetched: axes are
            metres of the site, and below the orthophoto lies the reference, where its files are there.

    Returns:
        A `plotly.graph_objects.Figure` with one trace for each registered component, in the order of cameras.csv, and a
        last one, CE90, for the circles that 90 percent of horizontal errors stay within, where these are predicted.

    Raises:
        BackendUnavailable: plotly is not installed.
    """
    return _on_basemap(result) if basemap else cameras_figure(result)


def cameras_figure(result: Result, max_pixels: float = 1e6) -> Any:
    """`plot_cameras` in metres of the site, on images of no more than `max_pixels`."""
    figure = require("plotly.graph_objects", "plot").Figure()
    for name, rows in _placed(result).items():
        figure.add_scatter(
            x=[row.east for row in rows],
            y=[row.north for row in rows],
            customdata=_about(rows),
            name=escape(name),
            mode="markers",
            marker={"size": 7, "line": {"width": 1, "color": "white"}},
            hovertemplate=HOVER,
        )
    circles = _circles(result)
    if len(circles):
        figure.add_scatter(x=circles[:, 0], y=circles[:, 1], **CIRCLE)
    figure.update_layout(
        title=_title(result),
        xaxis={"title": {"text": "east, m"}, "constrain": "domain", "showgrid": False, "zeroline": False},
        yaxis={
            "title": {"text": "north, m"},
            "scaleanchor": "x",
            "scaleratio": 1,
            "showgrid": False,
            "zeroline": False,
        },
        images=list(_background(mosaic_of(result, max_pixels))),
        showlegend=True,
    )
    return figure


def _on_basemap(result: Result) -> Any:
    figure = require("plotly.graph_objects", "plot").Figure()
    for name, rows in _placed(result).items():
        figure.add_scattermap(
            lat=[row.lat for row in rows],
            lon=[row.lon for row in rows],
            customdata=_about(rows),
            name=escape(name),
            mode="markers",
            marker={"size": 10},
            hovertemplate=HOVER_ON_BASEMAP,
        )
    circles = _circles(result)
    if len(circles):
        figure.add_scattermap(**_lat_lon(result, circles), **CIRCLE)
    figure.update_layout(title=_title(result), showlegend=True, map={"style": "open-street-map", **_zoom(result)})
    mosaic = mosaic_of(result)
    if mosaic.grid is not None and mosaic.model is not None:
        west, south, east, north = mosaic.grid.bounds
        corners = _lat_lon(result, np.array([[west, north], [east, north], [east, south], [west, south]]))
        places = list(zip(corners["lon"].tolist(), corners["lat"].tolist(), strict=True))
        source = _png_of(replace(mosaic, satellite=None))
        figure.update_layout(
            map_layers=[{"sourcetype": "image", "below": "traces", "source": source, "coordinates": places}]
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


def _title(result: Result) -> dict[str, str]:
    site = escape(str(result.summary.get("site", "")))
    return {"text": f"{site}: {len(result.registered_cameras)} of {len(result.cameras)} cameras have a position"}


def _about(rows: Sequence[CameraRow]) -> list[tuple[str, str]]:
    return [(escape(row.image), _accuracy(row)) for row in rows]


def _circles(result: Result) -> Array:
    """Outlines (n, 2) of the CE90 circles of all cameras, east and north in metres, with NaN between them."""
    angles = np.linspace(0, 2 * np.pi, CORNERS + 1)
    unit = np.column_stack([np.sin(angles), np.cos(angles)])
    gap = np.full((1, 2), np.nan)
    circles = [np.zeros((0, 2))]
    for row in result.registered_cameras:
        if row.ce90 is not None and row.east is not None and row.north is not None:
            circles += [row.ce90 * unit + [row.east, row.north], gap]
    return np.concatenate(circles)


def _lat_lon(result: Result, xy_enu: Array) -> dict[str, Array]:
    """Of plan positions (n, 2) in metres, NaN where they are."""
    known = np.isfinite(xy_enu).all(axis=1)
    found = np.full((len(xy_enu), 2), np.nan)
    found[known] = result.frame.lla_from_enu(np.column_stack([xy_enu[known], np.zeros(known.sum())]))[:, :2]
    return {"lat": found[:, 0], "lon": found[:, 1]}


def _zoom(result: Result) -> dict[str, Any]:
    """Centre and zoom of a web map that shows all cameras; tiles of zoom 0 are 40,075 km wide at the equator."""
    places = np.array([(row.lat, row.lon) for row in result.registered_cameras], np.float64)
    if not len(places):
        return {"center": {"lat": result.frame.lat_deg, "lon": result.frame.lon_deg}, "zoom": 14}
    lat, lon = (places.min(axis=0) + places.max(axis=0)) / 2
    height, width = np.ptp(places, axis=0) * [1.0, np.cos(np.radians(lat))]
    widest = max(float(height), float(width), 1e-3)
    return {
        "center": {"lat": float(lat), "lon": float(lon)},
        "zoom": float(np.log2(120 * np.cos(np.radians(lat)) / widest)),
    }


def _accuracy(row: CameraRow) -> str:
    known = [("up", row.up), ("CE90", row.ce90), ("LE90", row.le90)]
    return ", ".join(f"{name} {value:.2f} m" for name, value in known if value is not None)


def _background(mosaic: Mosaic) -> Iterator[dict[str, Any]]:
    """The model on the reference, which is faint, as one image in metres."""
    source = _png_of(mosaic)
    if mosaic.grid is None or not source:
        return
    west, south, east, north = mosaic.grid.bounds
    yield {
        "source": source,
        **{"xref": "x", "yref": "y", "x": west, "y": north, "sizex": east - west, "sizey": north - south},
        **{"sizing": "stretch", "layer": "below"},
    }


def _png_of(mosaic: Mosaic) -> str:
    """The image as a data URI, clear where nothing is known; empty where nothing is known at all."""
    if mosaic.grid is None:
        return ""
    rgba = np.zeros((*mosaic.grid.shape, 4), np.uint8)
    if mosaic.satellite is not None:
        rgba[..., :3], rgba[..., 3] = mosaic.satellite, FAINT
    if mosaic.model is not None and mosaic.model_mask is not None:
        rgba[mosaic.model_mask, :3], rgba[mosaic.model_mask, 3] = mosaic.model[mosaic.model_mask], SOLID
    if not rgba[..., 3].any():
        return ""
    png = cv2.imencode(".png", cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA))[1].tobytes()
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
