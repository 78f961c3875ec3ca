# SPDX-License-Identifier: Apache-2.0
"""The scene in a browser, by viser."""

from __future__ import annotations

import io
import secrets
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from skymoor.engines.libraries import require
from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.results.read import Result
from skymoor.results.viewer.access import only_with
from skymoor.results.viewer.cameras import CameraPanel
from skymoor.results.viewer.scene import parts_of
from skymoor.results.viewer.splats import Splats
from skymoor.results.viewer.surfaces import MODEL, SATELLITE, Layer, confidence_colours, legend_html
from skymoor.results.viewer.tape import MeasurePanel
from skymoor.types import Array, Array32

HOST = "127.0.0.1"  # to show a site in a network, forward the port
POLL_S = 0.5
POINT_M = 0.15
FARTHEST_M = 1e5  # that is drawn
Z_UP_FROM_Y_UP = (0.5**0.5, 0.5**0.5, 0.0, 0.0)  # glTF's axes
PHOTO, CONFIDENCE = "photos", "confidence"


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
        self._token = secrets.token_urlsafe(16)
        with redirect_stdout(io.StringIO()), only_with(self._token):  # without its banner
            self._server: Any = viser.ViserServer(
                host=HOST, port=port, verbose=False, label=f"skymoor: {result.summary.get('site', '')}"
            )
        server, self._result = self._server, result
        server.gui.configure_theme(show_logo=False, show_share_button=False)  # sharing would go through a relay outside
        server.scene.set_up_direction("+z")
        server.initial_camera.far = FARTHEST_M
        self._loading = server.gui.add_markdown("Loading, fine surfaces at the end ...")
        with server.gui.add_folder("Layers") as self._layers:
            self._colours = server.gui.add_dropdown("colours", (PHOTO, CONFIDENCE))
            self._legend = server.gui.add_html(legend_html(), visible=False)
        self._colours.on_update(lambda _: self._recolour())
        self._shown: dict[str, _Shown] = {}
        self._cameras = CameraPanel(server, result)
        self._tape = MeasurePanel(server, result, self._visible_surfaces)
        self._aimed = False

    @property
    def address(self) -> str:
        """On this machine, with the token that every request needs."""
        return f"http://{HOST}:{self._server.get_port()}/{self._token}/"

    def load(self) -> Iterator[str]:
        """Show all that there is, one by one; yields lines about what is missing. Raises `InputError` as `parts_of`."""
        for part in parts_of(self._result):
            if isinstance(part, str):
                yield part
            elif isinstance(part, Layer):
                self._aim(part.points)
                self._show(part)
            elif isinstance(part, Splats):
                self._aim(part.centres)
                self._show_splats(part)
            else:
                for name, frustums in part.items():
                    self._aim(np.array([one.position for one in frustums]))
                    self._cameras.add(name, frustums)
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
        position, look_at = middle + [0.0, -0.6 * reach, 0.45 * reach], middle - [0.0, 0.05 * reach, 0.0]
        start = self._server.initial_camera
        start.position, start.look_at = tuple(position), tuple(look_at)
        for client in self._server.get_clients().values():  # who came before there was anything to see
            client.camera.position, client.camera.look_at = tuple(position), tuple(look_at)

    def _show(self, layer: Layer) -> None:
        """In the place of a coarser one of the same name."""
        before = self._shown.get(layer.name)
        if before is None:
            with self._layers:
                box = self._server.gui.add_checkbox(layer.name, initial_value=True)
            self._shown[layer.name] = shown = _Shown(self._server, box, layer, self._result.frame)
            box.on_update(lambda _: shown.update(self._by_confidence))
        else:
            shown = before
            shown.replace(layer)
        shown.update(self._by_confidence)

    def _show_splats(self, part: Splats) -> None:
        handle = self._server.scene.add_gaussian_splats(
            f"/{part.name}", part.centres, part.covariances, part.rgb, part.opacity
        )
        with self._layers:
            box = self._server.gui.add_checkbox(f"splats {part.name}", initial_value=True)
        box.on_update(lambda _: setattr(handle, "visible", box.value))

    @property
    def _by_confidence(self) -> bool:
        return bool(self._colours.value == CONFIDENCE)

    def _recolour(self) -> None:
        self._legend.visible = self._by_confidence
        for shown in list(self._shown.values()):
            shown.update(self._by_confidence)

    def _visible_surfaces(self) -> list[Layer]:
        """The model before the reference that it lies on."""
        found = [self._shown[name] for name in (MODEL, SATELLITE) if name in self._shown]
        return [one.layer for one in found if one.box.value]


class _Shown:
    """A layer on the page, with its checkbox; what is drawn by confidence is made when it is first asked for."""

    def __init__(self, server: Any, box: Any, layer: Layer, frame: EnuFrame) -> None:
        self._server, self.box, self.layer, self._frame = server, box, layer, frame
        self._drawn: dict[bool, Any] = {}

    def replace(self, layer: Layer) -> None:
        before, self.layer, self._drawn = self._drawn, layer, {}
        for handle in before.values():  # of the same name in the scene, which the new one takes
            handle.remove()

    def update(self, by_confidence: bool) -> None:  # noqa: FBT001
        wanted = by_confidence and self.layer.confidence is not None
        if self.box.value and wanted not in self._drawn:
            self._drawn[wanted] = self._draw(wanted)
        for kind, handle in self._drawn.items():
            handle.visible = bool(self.box.value) and kind == wanted

    def _draw(self, by_confidence: bool) -> Any:  # noqa: FBT001
        layer, scene = self.layer, self._server.scene
        colours, name = layer.colours, f"/{layer.name}/{layer.level} {PHOTO}"
        if by_confidence and layer.confidence is not None:
            colours, name = confidence_colours(layer.confidence), f"/{layer.name}/{layer.level} {CONFIDENCE}"
        if layer.faces is None:
            return scene.add_point_cloud(
                name, layer.points, colours, point_size=POINT_M, point_shape="circle", precision="float32"
            )
        from skymoor.results.formats.gltf import mesh_glb

        glb = mesh_glb(layer.points.astype(np.float64), colours, layer.faces.astype(np.uint32), self._frame)
        return scene.add_glb(name, glb, wxyz=Z_UP_FROM_Y_UP)
