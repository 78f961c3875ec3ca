# SPDX-License-Identifier: Apache-2.0
"""Which photos came through one lens, found out from the photos themselves.

A walk round a building is too weak to calibrate each photo by itself: near a flat facade a longer lens from farther
away explains a photo as well, and cameras end up metres off. The photos of one phone calibrate it together. But a
folder of ground photos may hold several phones and security cameras, and says nothing about it. So every photo begins
with a lens of its own; where many agree about theirs, one shared lens is tried for all that could have it, and a photo
that it explains clearly worse gets its own back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray

from skymoor.engines.colmap import component_from_colmap, intrinsics_of
from skymoor.reconstruct.calibration import adjust, focal_sigmas
from skymoor.types import Array, Mask

MAX_ERROR_PX, MIN_ANGLE_DEG = 4.0, 1.5  # of an observation, and of the rays to a point: COLMAP's own limits

COLMAP_FOCAL_WIDTHS = 0.1, 10.0  # within which COLMAP itself takes a lens for one


@dataclass(frozen=True)
class IntrinsicsOptions:
    """When photos share a lens.

    Attributes:
        alike_focal_ratio, alike_k: lenses of single photos that differ by less, relative in focal length and in the
            first radial term, agree; the largest such crowd makes the first guess of a shared lens.
        candidate_focal_ratio, candidate_k: photos whose own lens differs from that guess by less are given the shared
            one for a trial: photos straight at a wall know little about their focal length.
        worse_ratio: growth of a photo's reprojection error, without its worst tenth, by which it shows another lens.
        min_photos: a crowd of fewer photos is chance.
        min_focal_widths, max_focal_widths: focal lengths of real lenses, in widths of the photo's longer side.
        max_distortion: of the first radial term of real lenses, either way.
        second_term_from: observations that determine a second radial term.
        min_observations: of a photo with a lens of its own; one with fewer is given up.
        max_focal_sigma: formal relative standard deviation of a focal length beyond which a photo is given up. The
            formal one is optimistic: the errors are about four times as large.
    """

    alike_focal_ratio: float = 0.06
    alike_k: float = 0.03
    candidate_focal_ratio: float = 0.4
    candidate_k: float = 0.1
    worse_ratio: float = 1.2
    min_photos: int = 4
    min_focal_widths: float = 0.3
    max_focal_widths: float = 4.0
    max_distortion: float = 1.0
    second_term_from: int = 150
    min_observations: int = 30
    max_focal_sigma: float = 0.02


def group_intrinsics(model: pycolmap.Reconstruction, options: IntrinsicsOptions) -> pycolmap.Reconstruction:
    """A copy, adjusted, in which the photos of one lens have one camera, and all others one of their own.

    Ids and names of images and points stay.
    """
    groups: list[list[int]] = []
    ids = sorted(model.reg_image_ids())
    own_px, observations = _errors_px(model)
    while True:
        taken = {i for group in groups for i in group}
        members = _candidates(model, [i for i in ids if i not in taken], options)
        while len(members) >= options.min_photos:
            trial = _regrouped(model, [*groups, members], options)
            adjust(trial, robust=True)
            shared_px, _ = _errors_px(trial)
            # The error of a photo with few observations is itself uncertain.
            excess = {i: shared_px[i] / own_px[i] - 1 / np.sqrt(max(observations[i], 1)) for i in members}
            worst = max(excess.values())
            if worst <= options.worse_ratio:
                break
            # A wrong member spoils its neighbours' fit: the worst go first, the others are judged again.
            members = [i for i in members if excess[i] < max(options.worse_ratio, 0.7 * worst)]
        if len(members) < options.min_photos:
            break
        groups.append(members)
    shared = _regrouped(model, groups, options)
    adjust(shared, robust=True)
    # A lens of its own fits wrong observations as well; the shared one shows them.
    pycolmap.ObservationManager(shared).filter_all_points3D(MAX_ERROR_PX, MIN_ANGLE_DEG)
    adjust(shared)
    return shared


def is_real(camera: pycolmap.Camera, options: IntrinsicsOptions) -> bool:
    """Whether a lens could be one; an adjustment that has lost its way leaves others behind."""
    return not camera.has_bogus_params(options.min_focal_widths, options.max_focal_widths, options.max_distortion)


def without_impossible(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """The model without photos through lenses that cannot be, such as of negative focal length.

    COLMAP's last adjustment leaves them behind where a photo has lost its way, and nothing can be computed with them.
    """
    for camera_id, users in _users(model).items():
        if model.camera(camera_id).has_bogus_params(*COLMAP_FOCAL_WIDTHS, np.inf):
            for i in users:
                model.deregister_frame(model.image(i).frame_id)
    return model


def without_doubtful(model: pycolmap.Reconstruction, options: IntrinsicsOptions) -> pycolmap.Reconstruction:
    """A copy without the photos whose own lens is impossible or not known: they stand anywhere along their rays."""
    copy = pycolmap.Reconstruction(model)
    sigmas = focal_sigmas(copy)
    for camera_id, users in _users(model).items():
        known = is_real(model.camera(camera_id), options)
        known &= sigmas.get(camera_id, float("inf")) <= options.max_focal_sigma
        known &= len(users) > 1 or model.image(users[0]).num_points3D >= options.min_observations
        if not known:
            for i in users:
                copy.deregister_frame(copy.image(i).frame_id)
    # What is no longer registered would still be in the way of the adjustment's covariance.
    return _regrouped(copy, [users for users in _users(copy).values() if len(users) > 1], options)


def shared_intrinsics(
    models: Sequence[pycolmap.Reconstruction], options: IntrinsicsOptions
) -> dict[str, pycolmap.Camera]:
    """The lens of each photo that shares one, by the photo's name, from reconstructions with shared lenses.

    Reconstructions are taken in order. A lens that is like an earlier one is the same, better known there.
    """
    lens_of: dict[str, pycolmap.Camera] = {}
    found: list[pycolmap.Camera] = []
    for model in models:
        for camera_id, users in sorted(_users(model).items(), key=lambda item: -len(item[1])):
            camera = model.camera(camera_id)
            if len(users) > 1 and is_real(camera, options):
                camera = next((other for other in found if _alike(camera, other, options)), camera)
                found.append(camera)
                lens_of = dict.fromkeys((model.image(i).name for i in users), camera) | lens_of
    return lens_of


def write_intrinsics(database: pycolmap.Database, lens_of: Mapping[str, pycolmap.Camera]) -> set[int]:
    """Give photos of a database these lenses; ids of their cameras. Each photo keeps a camera of its own.

    One without a lens begins with the most usual one: what it had before may have come from a wrong place.
    """
    usual = max(lens_of.values(), key=lambda camera: sum(camera is other for other in lens_of.values()), default=None)
    fixed: set[int] = set()
    for image in database.read_all_images():
        camera = database.read_camera(image.camera_id)
        lens = lens_of.get(image.name, usual)
        if lens is None or (lens.width, lens.height) != (camera.width, camera.height):
            continue
        written = pycolmap.Camera(
            model=lens.model, width=lens.width, height=lens.height, params=lens.params, camera_id=image.camera_id
        )
        written.has_prior_focal_length = image.name in lens_of
        database.update_camera(written)
        if image.name in lens_of:
            fixed.add(image.camera_id)
    return fixed


def _candidates(model: pycolmap.Reconstruction, ids: list[int], options: IntrinsicsOptions) -> list[int]:
    """The photos that could have the lens that most of `ids` agree about; none where no crowd agrees."""
    cameras = [model.camera(model.image(i).camera_id) for i in ids]
    real = [k for k, camera in enumerate(cameras) if is_real(camera, options)]
    if not real:
        return []
    sizes = np.array([(cameras[k].width, cameras[k].height) for k in real])
    focal = np.log([cameras[k].mean_focal_length() / cameras[k].width for k in real])
    radial = np.array([_radial(cameras[k])[0] for k in real])

    def near(k: int, focal_ratio: float, distortion: float) -> Mask:
        alike = (np.abs(focal - focal[k]) < np.log1p(focal_ratio)) & (np.abs(radial - radial[k]) < distortion)
        return np.asarray(alike & (sizes == sizes[k]).all(axis=1))

    crowds = [near(k, options.alike_focal_ratio, options.alike_k) for k in range(len(real))]
    best = int(np.argmax([crowd.sum() for crowd in crowds]))
    if crowds[best].sum() < options.min_photos:
        return []
    admitted = near(best, options.candidate_focal_ratio, options.candidate_k)
    return [ids[k] for k, is_in in zip(real, admitted, strict=True) if is_in]


def _regrouped(
    model: pycolmap.Reconstruction, groups: Sequence[Sequence[int]], options: IntrinsicsOptions
) -> pycolmap.Reconstruction:
    """A copy in which the images of each group share a camera, the median of theirs."""
    copy = pycolmap.Reconstruction()
    ids = sorted(model.reg_image_ids())
    taken = {i for group in groups for i in group}
    camera_of: dict[int, int] = {}
    for number, group in enumerate([*groups, *([i] for i in ids if i not in taken)], start=1):
        old = [model.camera(model.image(i).camera_id) for i in group]
        observations = sum(model.image(i).num_points3D for i in group)
        second_term = observations >= options.second_term_from
        copy.add_camera_with_trivial_rig(_median_camera(old, number, second_term=second_term))
        camera_of |= dict.fromkeys(group, number)
    for i in ids:
        image = model.image(i)
        keypoints = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
        fresh = pycolmap.Image(name=image.name, camera_id=camera_of[i], image_id=i, keypoints=keypoints)
        copy.add_image_with_trivial_frame(fresh, image.cam_from_world())
    for point in model.points3D.values():
        copy.add_point3D(point.xyz, point.track, point.color)
    copy.update_point_3d_errors()
    return copy


def _users(model: pycolmap.Reconstruction) -> dict[int, list[int]]:
    """Image ids by the camera that they have."""
    users: dict[int, list[int]] = {}
    for i in sorted(model.reg_image_ids()):
        users.setdefault(model.image(i).camera_id, []).append(i)
    return users


def _median_camera(cameras: Sequence[pycolmap.Camera], camera_id: int, *, second_term: bool) -> pycolmap.Camera:
    rows = [(c.mean_focal_length(), c.principal_point_x, c.principal_point_y, *_radial(c)) for c in cameras]
    *params, k2 = np.median(np.array(rows), axis=0).tolist()
    first = cameras[0]
    return pycolmap.Camera(
        model="RADIAL" if second_term else "SIMPLE_RADIAL",
        width=first.width,
        height=first.height,
        params=[*params, k2] if second_term else params,
        camera_id=camera_id,
    )


def _radial(camera: pycolmap.Camera) -> tuple[float, float]:
    """The first two radial terms."""
    distortion = intrinsics_of(camera).distortion
    return distortion[0], distortion[1]


def _alike(a: pycolmap.Camera, b: pycolmap.Camera, options: IntrinsicsOptions) -> bool:
    ratio = abs(float(np.log(a.mean_focal_length() / b.mean_focal_length())))
    same_size = (a.width, a.height) == (b.width, b.height)
    return same_size and ratio < options.alike_focal_ratio / 2 and abs(_radial(a)[0] - _radial(b)[0]) < options.alike_k


def _errors_px(model: pycolmap.Reconstruction) -> tuple[dict[int, float], dict[int, int]]:
    """Root mean square reprojection error, without the worst tenth, and number of observations, by image id."""
    names = {model.image(i).name: str(i) for i in model.reg_image_ids()}
    component = component_from_colmap(model, names)
    errors, counts = {}, {}
    for index, camera in enumerate(component.cameras):
        mine = component.obs_camera == index
        xyz_cam = camera.cam_from_world.apply(component.points[component.obs_point[mine]])
        gap: Array = camera.intrinsics.px_from_cam(xyz_cam) - component.obs_px[mine]
        squared: NDArray[np.float64] = np.nan_to_num(np.sum(gap**2, axis=1), nan=1e6)
        best = np.sort(squared)[: int(np.ceil(0.9 * len(squared)))]
        errors[int(camera.image)] = float(np.sqrt(best.mean())) if mine.any() else float("inf")
        counts[int(camera.image)] = int(mine.sum())
    return errors, counts
