# SPDX-License-Identifier: Apache-2.0
"""Between our frozen `Component` and COLMAP's mutable `Reconstruction`, both ways."""

from __future__ import annotations

import errno
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pycolmap

from skymoor.errors import DegenerateGeometry
from skymoor.geometry import Intrinsics, Similarity
from skymoor.types import Array, Camera, Component, Image

# COLMAP reports every step on stderr; what a person needs to know comes from skymoor itself, errors as exceptions.
pycolmap.logging.minloglevel = int(pycolmap.logging.Level.FATAL)

STOP = pycolmap.CancellationToken()
"""Ends COLMAP's long calls, in which Python's signals wait; the command line cancels it when the process is to end."""

BROWN = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
"""COLMAP's camera models that `Intrinsics` states; fisheye and division models have parameters of the same names."""


def intrinsics_of(camera: pycolmap.Camera) -> Intrinsics:
    """Our intrinsics of a COLMAP camera of the pinhole, radial or OPENCV kind.

    Raises:
        DegenerateGeometry: the camera model has no Brown form with two radial terms.
    """
    named = dict(zip(camera.params_info.replace(" ", "").split(","), map(float, camera.params), strict=True))
    if camera.model.name not in BROWN:
        raise DegenerateGeometry(f"camera model {camera.model.name} is not supported")
    radial = (named.get("k1", named.get("k", 0.0)), named.get("k2", 0.0))
    return Intrinsics(
        width=camera.width,
        height=camera.height,
        fx=named.get("fx", named.get("f", 0.0)),
        fy=named.get("fy", named.get("f", 0.0)),
        cx=named["cx"],
        cy=named["cy"],
        distortion=(*radial, named.get("p1", 0.0), named.get("p2", 0.0)),
    )


def component_from_colmap(reconstruction: pycolmap.Reconstruction, read_name: Mapping[str, str]) -> Component:
    """Freeze a COLMAP reconstruction; `read_name` maps its image names to photos. Colours are left black."""
    image_ids = sorted(reconstruction.reg_image_ids())
    point_ids = sorted(reconstruction.point3D_ids())
    index_of_point = {point_id: k for k, point_id in enumerate(point_ids)}
    cameras, obs_camera, obs_point, obs_px = [], [], [], []
    for index, image_id in enumerate(image_ids):
        image = reconstruction.image(image_id)
        cam_from_world = image.cam_from_world()
        pose = Similarity(1.0, cam_from_world.rotation.matrix(), np.array(cam_from_world.translation))
        cameras.append(Camera(read_name[image.name], intrinsics_of(reconstruction.camera(image.camera_id)), pose))
        for point2d in image.get_observation_points2D():
            obs_camera.append(index)
            obs_point.append(index_of_point[point2d.point3D_id])
            obs_px.append(point2d.xy)
    points = np.array([reconstruction.point3D(k).xyz for k in point_ids], dtype=np.float64).reshape(-1, 3)
    return Component(
        cameras=tuple(cameras),
        points=points,
        colours=np.zeros((len(points), 3), np.uint8),
        obs_camera=np.array(obs_camera, np.int32),
        obs_point=np.array(obs_point, np.int32),
        obs_px=np.array(obs_px, np.float64).reshape(-1, 2),
        reprojection_px=float(reconstruction.compute_mean_reprojection_error()),
    )


def colmap_from_component(component: Component) -> pycolmap.Reconstruction:
    """A COLMAP reconstruction in the component's frame; equal intrinsics share one OPENCV camera."""
    reconstruction = pycolmap.Reconstruction()
    id_of: dict[Intrinsics, int] = {}
    for camera in component.cameras:
        if camera.intrinsics not in id_of:
            id_of[camera.intrinsics] = len(id_of) + 1
            colmap_camera = _colmap_camera(camera.intrinsics, id_of[camera.intrinsics])
            reconstruction.add_camera_with_trivial_rig(colmap_camera)
    slot = np.zeros(len(component.obs_camera), np.int64)  # the number of an observation within its image
    for index, camera in enumerate(component.cameras):
        mine = np.flatnonzero(component.obs_camera == index)
        slot[mine] = np.arange(len(mine))
        image = pycolmap.Image(
            name=camera.image,
            camera_id=id_of[camera.intrinsics],
            image_id=index + 1,
            keypoints=component.obs_px[mine],
        )
        pose = camera.cam_from_world
        rigid = pycolmap.Rigid3d(pycolmap.Rotation3d(pose.rotation), pose.translation)
        reconstruction.add_image_with_trivial_frame(image, rigid)
    order = np.argsort(component.obs_point, kind="stable")
    starts = np.searchsorted(component.obs_point[order], np.arange(len(component.points) + 1))
    for k, (xyz, rgb) in enumerate(zip(component.points, component.colours, strict=True)):
        track = pycolmap.Track()
        for j in order[starts[k] : starts[k + 1]]:
            track.add_element(int(component.obs_camera[j]) + 1, int(slot[j]))
        reconstruction.add_point3D(xyz, track, rgb)
    reconstruction.update_point_3d_errors()
    return reconstruction


def write_colmap(component: Component, folder: Path) -> None:
    """Write a component as a COLMAP model into a folder.

    Raises `OSError` when what stands there is not what was written: COLMAP does not notice a full disk.
    """
    model = colmap_from_component(component)
    model.write(str(folder))
    try:
        found = pycolmap.Reconstruction(str(folder))
    except Exception:  # of a file that is cut off, anything
        found = pycolmap.Reconstruction()
    counts = [(one.num_images(), one.num_points3D(), one.compute_num_observations()) for one in (model, found)]
    if counts[0] != counts[1]:
        raise OSError(errno.ENOSPC, "COLMAP could not write all of it, is the disk full?", str(folder))


def _colmap_camera(intrinsics: Intrinsics, camera_id: int) -> pycolmap.Camera:
    i = intrinsics
    return pycolmap.Camera(
        model="OPENCV",
        width=i.width,
        height=i.height,
        params=[i.fx, i.fy, i.cx, i.cy, *i.distortion],
        camera_id=camera_id,
    )


def mean_colours(component: Component, read: Callable[[str], Image]) -> Array:
    """Mean colour (n, 3) of each point over the pixels that see it; `read` gives an image by name."""
    total = np.zeros((len(component.points), 3))
    count = np.zeros(len(component.points))
    for index, camera in enumerate(component.cameras):
        mine = component.obs_camera == index
        image = read(camera.image)
        u, v = np.floor(component.obs_px[mine]).astype(int).T
        u, v = np.clip(u, 0, image.shape[1] - 1), np.clip(v, 0, image.shape[0] - 1)
        np.add.at(total, component.obs_point[mine], image[v, u])
        np.add.at(count, component.obs_point[mine], 1)
    return np.asarray(total / np.maximum(count, 1)[:, None])
