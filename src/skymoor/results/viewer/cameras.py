# SPDX-License-Identifier: Apache-2.0
"""The cameras in the viewer: frusta, the photo of one of them, and ellipsoids of their accuracy."""

from __future__ import annotations

from math import tan
from typing import Any

import numpy as np

from skymoor.engines.libraries import require
from skymoor.engines.tensors import fitted
from skymoor.errors import InputError
from skymoor.results.read import Result
from skymoor.results.viewer.ellipsoids import KEYS, Ellipsoids, camera_ellipsoids
from skymoor.results.viewer.scene import Frustum
from skymoor.store import open_image
from skymoor.types import Image

THUMB_PX, PHOTO_PX = 160, 1200
THUMBS_FOR = 400  # with more cameras, photos are shown on a click only
COLOURS = ((255, 190, 40), (60, 190, 255), (255, 110, 180), (120, 225, 110), (255, 140, 60), (180, 150, 255))
NONE = "none"
LARGEST_FACTOR = 50
BACK_M = 0.05  # behind the camera, or its own frustum would be in the way
PLANE = 0.9  # distance of the photo in the scene, as a share of the camera's height above what is shown


class CameraPanel:
    """Switches of the cameras, the one that was chosen, and the ellipsoids."""

    def __init__(self, server: Any, result: Result) -> None:
        self._server, self._result = server, result
        rows = result.registered_cameras
        places = np.array([(row.east, row.north) for row in rows if row.set == rows[0].set], dtype=np.float64)
        self._many = len(rows) > THUMBS_FOR
        self._size = min(6.0, 0.04 * max(20.0, float(np.ptp(places, axis=0).max()) if len(rows) else 0.0))
        self._known: dict[str, Frustum] = {}
        self._handles: dict[str, Any] = {}
        self._groups = 0
        self._chosen: Frustum | None = None
        self._overlay: Any = None
        self._folder = server.gui.add_folder("Cameras")
        self._add_ellipsoids()
        with server.gui.add_folder("Photo"):
            self._choice = server.gui.add_dropdown("camera", (NONE,))
            self._words = server.gui.add_markdown("Choose a camera, or click one, to see its photo and accuracy.")
            self._photo = server.gui.add_image(np.zeros((2, 2, 3), np.uint8), visible=False)
            self._fly = server.gui.add_button("Fly there", visible=False)
            self._opacity = server.gui.add_slider("photo in the scene, %", 0, 100, 5, 0, visible=False)
        self._choice.on_update(lambda _: self._choose(self._choice.value))
        self._opacity.on_update(lambda _: self._lay())
        self._fly.on_click(lambda event: self._fly_to(event.client))

    def add(self, name: str, frustums: tuple[Frustum, ...]) -> None:
        """Those of a component."""
        colour = COLOURS[self._groups % len(COLOURS)]
        self._groups += 1
        handles = {one.row.image: self._shown(one, colour) for one in frustums}
        with self._folder:
            box = self._server.gui.add_checkbox(f"{name} ({len(handles)})", initial_value=True)

        def update(_: object) -> None:
            for handle in handles.values():
                handle.visible = box.value

        box.on_update(update)
        self._known |= {one.row.image: one for one in frustums}
        self._handles |= handles
        self._choice.options = (NONE, *self._known)

    def _shown(self, one: Frustum, colour: tuple[int, int, int]) -> Any:
        handle = self._server.scene.add_camera_frustum(
            f"/cameras/{one.row.set}_{one.row.component}/{one.row.image}",
            fov=one.fov_rad,
            aspect=one.aspect,
            scale=self._size,
            color=colour,
            thickness=1.5,
            thickness_units="screen",
            image=None if self._many else self._image(one, THUMB_PX),
            wxyz=one.enu_from_camera_wxyz,
            position=one.position,
        )

        def choose(_: object) -> None:
            self._choice.value = one.row.image

        handle.on_click(choose)
        return handle

    def _choose(self, image: str) -> None:
        """Show a camera beside the scene, and in it larger than the others."""
        if self._chosen is not None:
            self._handles[self._chosen.row.image].visible = True
        self._chosen = one = self._known.get(image)
        if one is not None:
            self._handles[image].visible = False  # its own small photo would hide what it looks at
        photo = None if one is None else self._image(one, PHOTO_PX)
        self._words.content = "No camera is chosen." if one is None else words_of(one)
        self._fly.visible = one is not None
        self._opacity.visible = self._photo.visible = photo is not None
        if photo is not None:
            self._photo.image = photo
        self._lay()

    def _lay(self) -> None:
        """The frustum of the chosen camera, down to near what it shows, with its photo as opaque as the slider says."""
        if self._overlay is not None:
            self._overlay.remove()
            self._overlay = None
        one = self._chosen
        if one is None:
            return
        photo = self._image(one, PHOTO_PX) if self._opacity.value else None
        if photo is not None:
            alpha = np.full((*photo.shape[:2], 1), round(2.55 * self._opacity.value), np.uint8)
            photo = np.concatenate([photo, alpha], axis=-1)
        self._overlay = self._server.scene.add_camera_frustum(
            "/photo",
            fov=one.fov_rad,
            aspect=one.aspect,
            scale=PLANE * self._height_of(one) * frustum_scale(one.fov_rad, one.aspect),
            color=(255, 255, 255),
            thickness=1.5,
            thickness_units="screen",
            image=photo,
            format="png",
            wxyz=one.enu_from_camera_wxyz,
            position=one.position,
        )

    def _height_of(self, one: Frustum) -> float:
        """Above the middle of its component's scene, metres; the distance to it for ground cameras."""
        centre = self._result.scene_centres().get((one.row.set, one.row.component or 0))
        away = np.array([0.0, 0.0, self._size]) if centre is None else one.position - centre
        return max(float(abs(away[2])), self._size)

    def _fly_to(self, client: Any) -> None:
        if self._chosen is None or client is None:
            return
        one = self._chosen
        camera = client.camera
        w, *v = one.enu_from_camera_wxyz
        ahead = _turned(w, np.array(v), np.array([0.0, 0.0, 1.0]))
        with client.atomic():
            camera.wxyz = one.enu_from_camera_wxyz
            camera.position = one.position - BACK_M * ahead
            camera.look_at = one.position + ahead * self._height_of(one)
            camera.fov = one.fov_rad

    def _image(self, one: Frustum, side_px: int) -> Image | None:
        try:
            with open_image(self._result.photo(one.row.image)) as image:
                image.draft("RGB", (side_px, side_px))  # JPEGs are decoded small, many times faster
                rgb = np.asarray(image.convert("RGB"))
        except (InputError, OSError):
            return None
        return fitted(rgb, side_px, 1)[0]

    def _add_ellipsoids(self) -> None:
        gui, drawn = self._server.gui, {"handle": None, "kind": NONE}
        with self._folder:
            kind = gui.add_dropdown("ellipsoids (90 %)", (NONE, *KEYS))
            factor = gui.add_slider("enlarged", 1, LARGEST_FACTOR, 1, 1)

        def update(_: object) -> None:
            handle: Any = drawn["handle"]
            if handle is not None and kind.value != drawn["kind"]:
                handle.remove()
                drawn["handle"] = handle = None
            if kind.value == NONE:
                return
            found = camera_ellipsoids(self._result, kind.value)
            if handle is None:
                drawn["handle"], drawn["kind"] = _drawn(self._server, found, factor.value), kind.value
            else:
                handle.batched_scales = (factor.value * found.semi_axes).astype(np.float32)

        kind.on_update(update)
        factor.on_update(update)


def _drawn(server: Any, found: Ellipsoids, factor: float) -> Any:
    ball = require("trimesh", "view").creation.icosphere(subdivisions=3)
    return server.scene.add_batched_meshes_simple(
        "/ellipsoids",
        np.asarray(ball.vertices, np.float32),
        np.asarray(ball.faces, np.uint32),
        batched_wxyzs=found.wxyz.astype(np.float32),
        batched_positions=found.positions.astype(np.float32),
        batched_scales=(factor * found.semi_axes).astype(np.float32),
        batched_colors=(255, 90, 60),
        opacity=0.45,
    )


def frustum_scale(fov_rad: float, aspect: float) -> float:
    """The `scale` of a frustum of viser whose image is at a distance of 1: viser gives all frusta the same volume."""
    half = tan(fov_rad / 2)
    return float(np.cbrt(half * half * aspect / 3.0))


def _turned(w: float, v: Any, vector: Any) -> Any:
    """A vector (3,) by a unit quaternion."""
    return vector + 2 * np.cross(v, np.cross(v, vector) + w * vector)


def words_of(one: Frustum) -> str:
    """Name, position and accuracy as Markdown; what is not a letter or a digit of a name is no markup."""
    from skymoor.results.report.words import number  # loads all criteria, a second

    row = one.row
    return (
        f"**{_plain(row.image)}**\n\n{_plain(row.set)} {row.component}\n\n"
        f"{number(row.lat, 7)}°, {number(row.lon, 7)}°, {number(row.height)} m\n\n"
        f"E {number(row.east)} N {number(row.north)} up {number(row.up)} m\n\n"
        f"CE90 {number(row.ce90)} m, LE90 {number(row.le90)} m; "
        f"relative {number(row.relative_ce90)} and {number(row.relative_le90)} m"
    )


def _plain(name: str) -> str:
    """Without anything that Markdown, HTML or the expressions of MDX could take for theirs."""
    return "".join(letter if letter.isalnum() or letter in " /" else f"&#{ord(letter)};" for letter in name)
