# SPDX-License-Identifier: Apache-2.0
"""Shared intrinsics: which photos come from one camera, estimated from the photos themselves.

Photos around a building do not determine the intrinsics of each photo: near a flat facade a longer focal length from
farther away fits as well, and camera positions are wrong by metres. The photos of one phone determine its intrinsics
together. But a folder of ground photos may mix several phones and security cameras, without metadata. So every photo
starts with its own intrinsics; where many agree, shared intrinsics are tried for all photos that may have them, and a
photo that fits clearly worse gets its own back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray

from skymoor.engines.colmap import component_from_colmap, intrinsics_of
from skymoor.reconstruct.calibration import adjust, focal_sigmas
from skymoor.reconstruct.parts import without_photos
from skymoor.types import Array, Mask

MAX_ERROR_PX, MIN_ANGLE_DEG = 4.0, 1.5  # of an observation, and between the rays to a point: COLMAP's limits

COLMAP_FOCAL_WIDTHS = 0.1, 10.0  # of plausible intrinsics, by COLMAP


@dataclass(frozen=True)
class IntrinsicsOptions:
    """When photos share intrinsics.

    Attributes:
        alike_focal_ratio, alike_k: intrinsics of single photos that differ by less, relative in focal length and in the
            first radial term, agree; the largest such cluster gives the initial shared intrinsics.
        candidate_focal_ratio, candidate_k: photos whose own intrinsics differ from these by less are tried with the
            shared ones: photos perpendicular to a wall hardly determine their focal length.
        worse_ratio: growth of a photo's reprojection error, without its worst tenth, that indicates another camera.
        min_photos: smaller clusters are ignored.
        min_focal_widths, max_focal_widths: plausible focal lengths, in units of the photo's longer side.
        max_distortion: largest plausible first radial term, in absolute value.
        second_term_from: observations that determine a second radial term.
        min_observations: of a photo with its own intrinsics; a photo with fewer is dropped.
        max_focal_sigma: formal relative standard deviation of a focal length beyond which a photo is dropped. The
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
    """A copy, adjusted, in which photos with shared intrinsics have one camera, and all others one each.

    Photos of impossible intrinsics are left out. Ids and names of images and points are kept.
    """
    groups: list[list[int]] = []
    model = without_impossible(model)
    ids = sorted(model.reg_image_ids())
    own_px, observations = _errors_px(model)
    while True:
        grouped = {i for group in groups for i in group}
        members = _candidates(model, [i for i in ids if i not in grouped], options)
        while len(members) >= options.min_photos:
            trial = _regrouped(model, [*groups, members], options)
            adjust(trial, robust=True)
            shared_px, _ = _errors_px(trial)
            # The error of a photo with few observations is itself uncertain.
            excess = {
                i: shared_px[i] / own_px[i] - 1 / np.sqrt(max(observations[i], 1)) if i in shared_px else np.inf
                for i in members
            }
            worst = max(excess.values())
            if worst <= options.worse_ratio:
                break
            # A wrong member degrades the fit of the others: the worst are removed first, the others are tested again.
            members = [i for i in members if excess[i] < max(options.worse_ratio, 0.7 * worst)]
        if len(members) < options.min_photos:
            break
        groups.append(members)
    shared = _regrouped(model, groups, options)
    adjust(shared, robust=True)
    # Own intrinsics adapt to wrong observations; shared ones expose them as outliers.
    pycolmap.ObservationManager(shared).filter_all_points3D(MAX_ERROR_PX, MIN_ANGLE_DEG)
    adjust(shared)
    return without_impossible(shared)


def is_plausible(camera: pycolmap.Camera, options: IntrinsicsOptions) -> bool:
    """Whether intrinsics are plausible; a diverged adjustment may leave others."""
    return not camera.has_bogus_params(options.min_focal_widths, options.max_focal_widths, options.max_distortion)


def without_impossible(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """The model without photos of impossible intrinsics, such as a negative focal length.

    An adjustment may leave such photos where it diverges; they cannot be used in computations.
    """
    lost = [
        i
        for camera_id, users in _users(model).items()
        if model.camera(camera_id).has_bogus_params(*COLMAP_FOCAL_WIDTHS, np.inf)
        for i in users
    ]
    return without_photos(model, lost) if lost else model


def without_doubtful(model: pycolmap.Reconstruction, options: IntrinsicsOptions) -> pycolmap.Reconstruction:
    """A copy without the photos whose own intrinsics are implausible or undetermined: their positions are too."""
    copy = pycolmap.Reconstruction(model)
    sigmas = focal_sigmas(copy)
    for camera_id, users in _users(model).items():
        known = is_plausible(model.camera(camera_id), options)
        known &= sigmas.get(camera_id, float("inf")) <= options.max_focal_sigma
        known &= len(users) > 1 or model.image(users[0]).num_points3D >= options.min_observations
        if not known:
            for i in users:
                copy.deregister_frame(copy.image(i).frame_id)
    # Images that are no longer registered would make the covariance of the adjustment fail.
    return _regrouped(copy, [users for users in _users(copy).values() if len(users) > 1], options)


def shared_intrinsics(
    models: Sequence[pycolmap.Reconstruction], options: IntrinsicsOptions
) -> dict[str, pycolmap.Camera]:
    """The intrinsics of each photo that shares them, by the photo's name, from grouped reconstructions.

    Reconstructions are processed in order. Intrinsics close to earlier ones are replaced by those.
    """
    camera_of: dict[str, pycolmap.Camera] = {}
    found: list[pycolmap.Camera] = []
    for model in models:
        for camera_id, users in sorted(_users(model).items(), key=lambda item: -len(item[1])):
            camera = model.camera(camera_id)
            if len(users) > 1 and is_plausible(camera, options):
                camera = next((other for other in found if _alike(camera, other, options)), camera)
                found.append(camera)
                camera_of = dict.fromkeys((model.image(i).name for i in users), camera) | camera_of
    return camera_of


def write_intrinsics(database: pycolmap.Database, known_cameras: Mapping[str, pycolmap.Camera]) -> set[int]:
    """Write known intrinsics to the photos of a database; returns the ids of their cameras.

    Each photo keeps its own camera. Photos without known intrinsics start with the most frequent ones: their former
    ones may be wrong.
    """
    cameras = known_cameras.values()
    usual = max(cameras, key=lambda camera: sum(camera is other for other in cameras), default=None)
    fixed: set[int] = set()
    for image in database.read_all_images():
        camera = database.read_camera(image.camera_id)
        known = known_cameras.get(image.name, usual)
        if known is None or (known.width, known.height) != (camera.width, camera.height):
            continue
        written = pycolmap.Camera(
            model=known.model, width=known.width, height=known.height, params=known.params, camera_id=image.camera_id
        )
        written.has_prior_focal_length = image.name in known_cameras
        database.update_camera(written)
        if image.name in known_cameras:
            fixed.add(image.camera_id)
    return fixed


def _candidates(model: pycolmap.Reconstruction, ids: list[int], options: IntrinsicsOptions) -> list[int]:
    """The photos that may have the intrinsics of the largest cluster of `ids`; none without a cluster."""
    cameras = [model.camera(model.image(i).camera_id) for i in ids]
    plausible = [k for k, camera in enumerate(cameras) if is_plausible(camera, options)]
    if not plausible:
        return []
    sizes = np.array([(cameras[k].width, cameras[k].height) for k in plausible])
    focal = np.log([cameras[k].mean_focal_length() / cameras[k].width for k in plausible])
    radial = np.array([_radial(cameras[k])[0] for k in plausible])

    def near(k: int, focal_ratio: float, distortion: float) -> Mask:
        alike = (np.abs(focal - focal[k]) < np.log1p(focal_ratio)) & (np.abs(radial - radial[k]) < distortion)
        return np.asarray(alike & (sizes == sizes[k]).all(axis=1))

    clusters = [near(k, options.alike_focal_ratio, options.alike_k) for k in range(len(plausible))]
    best = int(np.argmax([cluster.sum() for cluster in clusters]))
    if clusters[best].sum() < options.min_photos:
        return []
    admitted = near(best, options.candidate_focal_ratio, options.candidate_k)
    return [ids[k] for k, is_in in zip(plausible, admitted, strict=True) if is_in]


def _regrouped(
    model: pycolmap.Reconstruction, groups: Sequence[Sequence[int]], options: IntrinsicsOptions
) -> pycolmap.Reconstruction:
    """A copy in which the images of each group share a camera, the median of theirs."""
    copy = pycolmap.Reconstruction()
    ids = sorted(model.reg_image_ids())
    grouped = {i for group in groups for i in group}
    camera_of: dict[int, int] = {}
    for number, group in enumerate([*groups, *([i] for i in ids if i not in grouped)], start=1):
        old = [model.camera(model.image(i).camera_id) for i in group]
        observations = sum(model.image(i).num_points3D for i in group)
        second_term = observations >= options.second_term_from
        copy.add_camera_with_trivial_rig(_median_camera(old, number, second_term=second_term))
        camera_of |= dict.fromkeys(group, number)
    for i in ids:
        image = model.image(i)
        keypoints = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
        copied = pycolmap.Image(name=image.name, camera_id=camera_of[i], image_id=i, keypoints=keypoints)
        copy.add_image_with_trivial_frame(copied, image.cam_from_world())
    for point in model.points3D.values():
        copy.add_point3D(point.xyz, point.track, point.color)
    copy.update_point_3d_errors()
    return copy


def _users(model: pycolmap.Reconstruction) -> dict[int, list[int]]:
    """Image ids by camera id."""
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
    """The first two radial terms of the distortion."""
    distortion = intrinsics_of(camera).distortion
    return distortion[0], distortion[1]


def _alike(a: pycolmap.Camera, b: pycolmap.Camera, options: IntrinsicsOptions) -> bool:
    ratio = abs(float(np.log(a.mean_focal_length() / b.mean_focal_length())))
    same_size = (a.width, a.height) == (b.width, b.height)
    return same_size and ratio < options.alike_focal_ratio / 2 and abs(_radial(a)[0] - _radial(b)[0]) < options.alike_k


def _errors_px(model: pycolmap.Reconstruction) -> tuple[dict[int, float], dict[int, int]]:
    """Root mean square reprojection error, without the worst tenth, and number of observations, by image id.

    Photos whose intrinsics have become impossible have neither.
    """
    model = without_impossible(model)
    names = {model.image(i).name: str(i) for i in model.reg_image_ids()}
    component = component_from_colmap(model, names)
    errors, counts = {}, {}
    for index, camera in enumerate(component.cameras):
        own = component.obs_camera == index
        xyz_cam = camera.cam_from_world.apply(component.points[component.obs_point[own]])
        gap: Array = camera.intrinsics.px_from_cam(xyz_cam) - component.obs_px[own]
        squared: NDArray[np.float64] = np.nan_to_num(np.sum(gap**2, axis=1), nan=1e6)
        best = np.sort(squared)[: int(np.ceil(0.9 * len(squared)))]
        errors[int(camera.image)] = float(np.sqrt(best.mean())) if own.any() else float("inf")
        counts[int(camera.image)] = int(own.sum())
    return errors, counts
