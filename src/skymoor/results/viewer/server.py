# SPDX-License-Identifier: Apache-2.0
"""The scene in a browser, by viser."""

from __future__ import annotations

import io
import time
import webbrowser
from collections.abc import Callable
from contextlib import redirect_stdout
from html import escape
from typing import Any

import numpy as np

from skymoor.engines.libraries import require
from skymoor.engines.tensors import fitted
from skymoor.errors import InputError
from skymoor.results.read import Result
from skymoor.results.report.words import number
from skymoor.results.viewer.scene import Frustum, Layer, Scene, scene_of
from skymoor.store import open_image
from skymoor.types import Image

HOST = "127.0.0.1"  # to show a site in a network, forward the port
THUMB_PX, PHOTO_PX = 160, 900
THUMBS_FOR = 400  # with more cameras, photos are shown on a click only
COLOURS = ((255, 190, 40), (60, 190, 255), (255, 110, 180), (120, 225, 110), (255, 140, 60), (180, 150, 255))


def view_run(result: Result, *, port: int, browser: bool, note: Callable[[str], None]) -> None:
    """Show a run until it is interrupted. Raises `InputError` for a port that is none, `BackendUnavailable`."""
    if not 0 < port < 65536:
        raise InputError(f"--port {port}: give a whole number from 1 to 65535")
    require("viser", "view")  # before the work of gathering the scene
    scene = scene_of(result)
    for line in scene.notes:
        note(line)
    server = serve(result, scene, port)
    address = f"http://{HOST}:{server.get_port()}"
    note(f"{address}: the viewer; stop it with Ctrl+C")
    if browser:
        webbrowser.open(address)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        note("stopped")
    finally:
        server.stop()


def serve(result: Result, scene: Scene, port: int) -> Any:
    """A running viser server of the scene; the caller stops it."""
    viser = require("viser", "view")
    with redirect_stdout(io.StringIO()):  # its banner; the address is printed below
        server = viser.ViserServer(
            host=HOST, port=port, verbose=False, label=f"skymoor: {result.summary.get('site', '')}"
        )
    server.scene.set_up_direction("+z")
    _aim(server, scene)
    with server.gui.add_folder("Layers"):
        for layer in scene.layers:
            _switch(server, layer.name, [_shown(server, layer)], visible=layer.name != "model surface")
    details = _Details(server, result)
    with server.gui.add_folder("Cameras"):
        for k, (name, frustums) in enumerate(scene.cameras.items()):
            handles = [details.shown(one, COLOURS[k % len(COLOURS)], scene) for one in frustums]
            _switch(server, f"{name} ({len(handles)})", handles, visible=True)
    return server


def _switch(server: Any, label: str, handles: list[Any], *, visible: bool) -> None:
    box = server.gui.add_checkbox(label, visible)

    def update(_: object) -> None:
        for handle in handles:
            handle.visible = box.value

    box.on_update(update)
    update(None)


def _shown(server: Any, layer: Layer) -> Any:
    name = f"/{layer.name}"
    if layer.faces is None:
        return server.scene.add_point_cloud(name, layer.points, layer.colours, point_size=0.15, point_shape="circle")
    trimesh = require("trimesh", "view")
    mesh = trimesh.Trimesh(layer.points, layer.faces, vertex_colors=layer.colours, process=False)
    return server.scene.add_mesh_trimesh(name, mesh)


def _aim(server: Any, scene: Scene) -> None:
    """Start south of everything, looking down on it."""
    centres = [one.position for frustums in scene.cameras.values() for one in frustums]
    points = np.array(centres) if centres else scene.layers[0].points.astype(np.float64)
    middle, reach = np.median(points, axis=0), float(np.ptp(points[:, :2], axis=0).max()) + 30.0

    def look(client: Any) -> None:
        client.camera.up_direction = (0.0, 0.0, 1.0)
        client.camera.position = tuple(middle + [0.0, -0.75 * reach, 0.5 * reach])
        client.camera.look_at = tuple(middle - [0.0, 0.0, 0.3 * reach])

    server.on_client_connect(look)


class _Details:
    """The camera that was clicked last: its photo, position and accuracy beside the scene."""

    def __init__(self, server: Any, result: Result) -> None:
        self._server, self._result = server, result
        with server.gui.add_folder("Camera"):
            self._words = server.gui.add_markdown("Click a camera to see its photo, position and accuracy.")
            self._photo = server.gui.add_image(np.zeros((2, 2, 3), np.uint8), visible=False)

    def shown(self, one: Frustum, colour: tuple[int, int, int], scene: Scene) -> Any:
        """The camera in the scene, which shows its details when it is clicked."""
        many = sum(map(len, scene.cameras.values())) > THUMBS_FOR
        size = 0.04 * max(20.0, float(np.ptp([c.position for c in next(iter(scene.cameras.values()))], axis=0).max()))
        handle = self._server.scene.add_camera_frustum(
            f"/cameras/{one.row.set}_{one.row.component}/{one.row.image}",
            fov=one.fov_rad,
            aspect=one.aspect,
            scale=min(size, 6.0),
            color=colour,
            image=None if many else self._image(one, THUMB_PX),
            wxyz=one.enu_from_camera_wxyz,
            position=one.position,
        )
        handle.on_click(lambda _: self.show(one))
        return handle

    def show(self, one: Frustum) -> None:
        """Show it beside the scene."""
        self._words.content = words_of(one)
        photo = self._image(one, PHOTO_PX)
        self._photo.visible = photo is not None
        if photo is not None:
            self._photo.image = photo

    def _image(self, one: Frustum, side_px: int) -> Image | None:
        try:
            with open_image(self._result.photo(one.row.image)) as image:
                image.draft("RGB", (side_px, side_px))  # JPEGs are decoded small, many times faster
                rgb = np.asarray(image.convert("RGB"))
        except (InputError, OSError):
            return None
        return fitted(rgb, side_px, 1)[0]


def words_of(one: Frustum) -> str:
    """Name, position and accuracy as Markdown; what is not a letter or a digit of a name is no markup."""
    row = one.row
    name = "".join(letter if letter.isalnum() or letter in " /" else f"&#{ord(letter)};" for letter in row.image)
    return (
        f"**{name}**\n\n{escape(row.set)} {row.component}\n\n"
        f"{number(row.lat, 7)}°, {number(row.lon, 7)}°, {number(row.height)} m\n\n"
        f"E {number(row.east)} N {number(row.north)} up {number(row.up)} m\n\n"
        f"CE90 {number(row.ce90)} m, LE90 {number(row.le90)} m; "
        f"relative {number(row.relative_ce90)} and {number(row.relative_le90)} m"
    )
