# SPDX-License-Identifier: Apache-2.0
"""Whether photos of another scale have another lens or another flying height, and the focal length of that lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap

from skymoor.reconstruct.calibration import AS_GOOD, adjust, thin

HEIGHT_SPREAD = 0.1
"""Relative standard deviation of flying heights within a flight: how well scales in the image give the ratio of two
focal lengths. Relief gives it less well: on real photos, ratios from 1.6 to 3.2 fitted within 3 percent."""
ITERATIONS = 200


@dataclass(frozen=True)
class Lens:
    """A camera of a model, by its id, whose photos show the ground `ratio` times larger than those of another."""

    camera_id: int
    reference_id: int
    ratio: float


def is_own(model: pycolmap.Reconstruction, lens: Lens) -> bool:
    """Whether a camera of the model is another lens, and not the same one at another height.

    The model's tie points are adjusted with the reference's focal length for both, from where the photos would be then:
    with a shorter focal length, closer to what they show. `AS_GOOD` is the growth of the squared residuals up to which
    two calibrations count as equally good; where a shared focal length is as good, the photos are taken for those of
    another flying height. False where the model does not have both.
    """
    present = {model.image(i).camera_id for i in model.reg_image_ids()}
    if not {lens.camera_id, lens.reference_id} <= present:
        return False
    base = thin(model)
    own = adjust(base, max_iterations=ITERATIONS)
    set_focal(base, lens.camera_id, base.camera(lens.reference_id).mean_focal_length())
    return (adjust(base, focal=False, max_iterations=ITERATIONS) / own) ** 2 - 1 > AS_GOOD


def tie_focal_lengths(model: pycolmap.Reconstruction, lenses: Sequence[Lens]) -> list[int]:
    """Give each lens the focal length that its scale says for photos of one flight; returns the ids of these cameras.

    Where that fits clearly worse than the one that relief says, the heights differ as well, and it is left alone.
    """
    tied = []
    for lens in lenses:
        if lens.camera_id not in model.cameras or lens.reference_id not in model.cameras:
            continue
        free = pycolmap.Reconstruction(model)
        own = adjust(free, max_iterations=ITERATIONS)
        set_focal(free, lens.camera_id, lens.ratio * free.camera(lens.reference_id).mean_focal_length())
        if (adjust(free, focal=False, max_iterations=ITERATIONS) / own) ** 2 - 1 <= AS_GOOD:
            reference_px = model.camera(lens.reference_id).mean_focal_length()
            set_focal(model, lens.camera_id, lens.ratio * reference_px)
            adjust(model, focal=False, max_iterations=ITERATIONS)
            tied.append(lens.camera_id)
    return tied


def set_focal(model: pycolmap.Reconstruction, camera_id: int, focal_px: float) -> None:
    """Change the focal length of a camera, and move its photos along their axes to where they show the same."""
    camera = model.camera(camera_id)
    ratio = focal_px / camera.mean_focal_length()
    params = np.array(camera.params)
    for index in camera.focal_length_idxs():
        params[index] *= ratio
    camera.params = params.tolist()
    for i in model.reg_image_ids():
        image = model.image(i)
        if image.camera_id != camera_id:
            continue
        pose, frame = image.cam_from_world(), image.frame
        ids = [point.point3D_id for point in image.get_observation_points2D()]
        xyz = np.array([model.point3D(k).xyz for k in ids]).reshape(-1, 3)
        if frame is None or not len(xyz):
            continue
        depth = float(np.median(xyz @ pose.rotation.matrix()[2] + pose.translation[2]))
        x, y, z = np.asarray(pose.translation).tolist()
        frame.rig_from_world = pycolmap.Rigid3d(pose.rotation, [x, y, z + depth * (ratio - 1)])
