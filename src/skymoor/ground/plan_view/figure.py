# SPDX-License-Identifier: Apache-2.0
"""A ground component drawn on the orthophoto: what a person looks at to believe a place or not."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from skymoor.geometry import Similarity
from skymoor.ground.plan_view.template import plan_model
from skymoor.types import Array, DepthMap, Image, Reference

SIDE_PX = 900
MARGIN_M = 25.0  # round the cameras
WALLS, FREE, CAMERAS = (230, 40, 40), (60, 200, 255), (255, 220, 0)


def plan_figure(maps_level: Sequence[DepthMap], reference: Reference, enu_from_level: Similarity, seed: int) -> Image:
    """The orthophoto (h, w, 3) round the cameras with these and their views, walls and free space of a component."""
    points = plan_model(maps_level, rng=np.random.default_rng(seed)).points(
        reference.grid.pixel_m / enu_from_level.scale
    )
    cameras = [one.camera.transformed(enu_from_level) for one in maps_level]
    centres = np.array([camera.centre[:2] for camera in cameras])
    (west, south), (east, north) = centres.min(axis=0) - MARGIN_M, centres.max(axis=0) + MARGIN_M
    pixel = max(east - west, north - south) / SIDE_PX

    def px(xy: Array) -> Array:
        return np.asarray(np.column_stack([xy[:, 0] - west, north - xy[:, 1]]) / pixel)

    corners = reference.grid.px_from_enu(np.array([[west, north]]))[0]
    zoom = pixel / reference.grid.pixel_m
    shape = int((east - west) / pixel), int((north - south) / pixel)
    # Centres of pixels: half a pixel of either picture.
    warp = np.array([[zoom, 0, corners[0] + zoom / 2 - 0.5], [0, zoom, corners[1] + zoom / 2 - 0.5]])
    figure = cv2.warpAffine(reference.rgb, warp, shape, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    figure = np.ascontiguousarray(figure // 2 + 100)
    for xy, colour in ((points.free, FREE), (points.walls, WALLS)):
        enu = enu_from_level.apply(np.column_stack([xy, np.zeros(len(xy))]))
        for u, v in np.round(px(enu[:, :2])).astype(int).tolist():
            cv2.circle(figure, (u, v), 2, colour, -1)
    for camera, at in zip(cameras, np.round(px(centres)).astype(int).tolist(), strict=True):
        ahead = camera.cam_from_world.rotation[2, :2] * [1, -1]
        tip = np.round(np.array(at) + 3.0 / pixel * ahead / max(float(np.linalg.norm(ahead)), 1e-6)).astype(int)
        cv2.arrowedLine(figure, at, tip.tolist(), CAMERAS, 2, cv2.LINE_AA, tipLength=0.3)
        cv2.circle(figure, at, 4, CAMERAS, -1, cv2.LINE_AA)
    return np.asarray(figure, dtype=np.uint8)
