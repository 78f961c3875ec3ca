# SPDX-License-Identifier: Apache-2.0
"""The scene in a browser, by viser."""

from __future__ import annotations

import io
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from html import escape
from typing import Any

import numpy as np

from skymoor.engines.libraries import require
from skymoor.engines.tensors import fitted
from skymoor.errors import InputError
from skymoor.results.read import Result
from skymoor.results.viewer.scene import Frustum, Layer, parts_of
from skymoor.store import open_image
from skymoor.types import Array, Array32, Image

HOST = "127.0.0.1"  # to show a site in a network, forward the port
POLL_S = 0.5
THUMB_PX, PHOTO_PX = 160, 900
THUMBS_FOR = 400  # with more cameras, photos are shown on a click only
COLOURS = ((255, 190, 40), (60, 190, 255), (255, 110, 180), (120, 225, 110), (255, 140, 60), (180, 150, 255))


def view_run(result: Result, *, port: int, browser: bool, note: Callable[[str], None]) -> None:
    """Show a run until it is interrupted: at once, and more of it as it is loaded.

    Raises `InputError` for a port that is none and for a run of which there is nothing to see, `BackendUnavailable`.
    """
    if not 0 < port < 65536:
        raise InputError(f"--port {port}: give a whole number from 1 to 65535")
    page = Page(result, port)
    try:
        note(f"{page.address}: the viewer; stop it with Ctrl+C")
        if browser:
            webbrowser.open(page.address)
        for line in page.load():
            note(line)
        while True:
            time.sleep(POLL_S)  # in steps, so that Ctrl+C is heard
    except KeyboardInterrupt:
        note("stopped")
    finally:
        page.stop()


class Page:
    """A running viser server of a run; stop it in the end."""

    def __init__(self, result: Result, port: int) -> None:
        """Raises `BackendUnavailable` without viser."""
        viser = require("viser", "view")
        with redirect_stdout(io.StringIO()):  # its banner
            self._server: Any = viser.ViserServer(
                host=HOST, port=port, verbose=False, label=f"skymoor: {result.summary.get('site', '')}"
            )
        self._result = result
        self._server.scene.set_up_direction("+z")
        self._loading = self._server.gui.add_markdown("Loading, what is large at the end ...")
        self._layers = self._server.gui.add_folder("Layers")
        self._cameras = self._server.gui.add_folder("Cameras")
        self._details = _Details(self._server, result)
        self._aimed = False

    @property
    def address(self) -> str:
        """On this machine."""
        return f"http://{HOST}:{self._server.get_port()}"

    def load(self) -> Iterator[str]:
        """Show all that there is, one by one; yields lines about what is missing. Raises `InputError` as `parts_of`."""
        shown = 0
        for part in parts_of(self._result):
            if isinstance(part, str):
                yield part
            elif isinstance(part, Layer):
                self._aim(part.points)
                with self._layers:
                    _switch(self._server, part.name, [_shown(self._server, part)], visible=part.name != "model surface")
            else:
                for name, frustums in part.items():
                    self._aim(np.array([one.position for one in frustums]))
                    handles = [self._details.shown(one, COLOURS[shown % len(COLOURS)]) for one in frustums]
                    with self._cameras:
                        _switch(self._server, f"{name} ({len(handles)})", handles, visible=True)
                    shown += 1
        self._loading.remove()

    def stop(self) -> None:
        """Close the page."""
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    def _aim(self, points: Array | Array32) -> None:
        """Start south of what is shown first, looking down on it."""
        if self._aimed or not len(points):
            return
        self._aimed = True
        middle, reach = np.median(points, axis=0), float(np.ptp(points[:, :2], axis=0).max()) + 30.0

        def look(client: Any) -> None:
            client.camera.up_direction = (0.0, 0.0, 1.0)
            client.camera.position = tuple(middle + [0.0, -0.75 * reach, 0.5 * reach])
            client.camera.look_at = tuple(middle - [0.0, 0.0, 0.3 * reach])

        self._server.on_client_connect(look)
        for client in self._server.get_clients().values():  # who came before there was anything to see
            look(client)


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


class _Details:
    """The camera that was clicked last: its photo, position and accuracy beside the scene."""

    def __init__(self, server: Any, result: Result) -> None:
        self._server, self._result = server, result
        rows = result.registered_cameras
        places = np.array([(row.east, row.north) for row in rows if row.set == rows[0].set], dtype=np.float64)
        self._many = len(rows) > THUMBS_FOR
        self._size = min(6.0, 0.04 * max(20.0, float(np.ptp(places, axis=0).max()) if len(rows) else 0.0))
        with server.gui.add_folder("Camera"):
            self._words = server.gui.add_markdown("Click a camera to see its photo, position and accuracy.")
            self._photo = server.gui.add_image(np.zeros((2, 2, 3), np.uint8), visible=False)

    def shown(self, one: Frustum, colour: tuple[int, int, int]) -> Any:
        """The camera in the scene, which shows its details when it is clicked."""
        handle = self._server.scene.add_camera_frustum(
            f"/cameras/{one.row.set}_{one.row.component}/{one.row.image}",
            fov=one.fov_rad,
            aspect=one.aspect,
            scale=self._size,
            color=colour,
            image=None if self._many else self._image(one, THUMB_PX),
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
    from skymoor.results.report.words import number  # loads all criteria, a second

    row = one.row
    name = "".join(letter if letter.isalnum() or letter in " /" else f"&#{ord(letter)};" for letter in row.image)
    return (
        f"**{name}**\n\n{escape(row.set)} {row.component}\n\n"
        f"{number(row.lat, 7)}°, {number(row.lon, 7)}°, {number(row.height)} m\n\n"
        f"E {number(row.east)} N {number(row.north)} up {number(row.up)} m\n\n"
        f"CE90 {number(row.ce90)} m, LE90 {number(row.le90)} m; "
        f"relative {number(row.relative_ce90)} and {number(row.relative_le90)} m"
    )
