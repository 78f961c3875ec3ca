# SPDX-License-Identifier: Apache-2.0
"""The lenses of a reconstruction: their calibration, how well it is determined, and what it leaves over the image."""

from __future__ import annotations

from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from skymoor.engines.colmap import colmap_from_component
from skymoor.geometry import Intrinsics
from skymoor.reconstruct.calibration import rms_px, thin
from skymoor.types import Array, Component

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
FIELD_COLUMNS, FIELD_ROWS = 9, 7  # of the residuals over the image
FIELD_LEAST = 5  # observations in a cell: the mean of fewer is noise
MAX_CAMERAS = 400  # beyond, the covariance of the adjustment takes minutes


def lens_figures(component: Component) -> list[dict[str, Any]]:
    """Of each lens: photos, calibration in pixels, and standard deviations.

    Standard deviations are None where the adjustment does not determine a parameter: a principal point that was held
    at the centre of the image, distortion terms that were held at zero.
    """
    lenses, numbers = _lenses(component)
    sigmas = _sigmas(component, lenses)
    return [
        {
            "n_photos": int((numbers == k).sum()),
            "width": lens.width,
            "height": lens.height,
            **dict(zip(PARAMETERS, _values(lens), strict=True)),
            "sigma": sigmas[k],
        }
        for k, lens in enumerate(lenses)
    ]


def lens_residuals(component: Component, residuals: Array) -> list[list[list[float]]]:
    """The means of `residuals` (n, 2) of all observations over the image of each lens, see `residual_field`."""
    lenses, numbers = _lenses(component)
    own = [numbers[component.obs_camera] == k for k in range(len(lenses))]
    return [
        residual_field(lens, component.obs_px[mine], residuals[mine]) for lens, mine in zip(lenses, own, strict=True)
    ]


def residual_field(lens: Intrinsics, px: Array, residuals: Array) -> list[list[float]]:
    """Mean residuals (n, 2) at pixels (n, 2) in cells of the image.

    Rows of u and v of the middle of a cell, the mean residual right and down, all in pixels, and how many observations
    it is of; cells with fewer than five are left out.
    """
    shape = np.array([FIELD_COLUMNS, FIELD_ROWS])
    size = np.array([lens.width, lens.height]) / shape
    known = np.isfinite(residuals).all(axis=1)
    cells = np.clip(np.floor(px[known] / size), 0, shape - 1).astype(int)
    flat = cells[:, 1] * FIELD_COLUMNS + cells[:, 0]
    vectors = []
    for cell in np.unique(flat):
        mine = residuals[known][flat == cell]
        if len(mine) >= FIELD_LEAST:
            middle = (np.array([cell % FIELD_COLUMNS, cell // FIELD_COLUMNS]) + 0.5) * size
            vectors.append([*middle.round(1).tolist(), *mine.mean(axis=0).round(4).tolist(), len(mine)])
    return vectors


def _lenses(component: Component) -> tuple[list[Intrinsics], NDArray[np.int64]]:
    """The lenses in a fixed order, and the number of each camera's."""
    lenses = sorted({camera.intrinsics for camera in component.cameras}, key=_order)
    return lenses, np.array([lenses.index(camera.intrinsics) for camera in component.cameras], dtype=np.int64)


def _order(lens: Intrinsics) -> tuple[float, ...]:
    return (lens.width, lens.height, *_values(lens))


def _values(lens: Intrinsics) -> tuple[float, ...]:
    return (lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion)


def _centred(lens: Intrinsics) -> bool:
    """Whether the principal point was held at the centre of the image: adjusted ones are never exactly there."""
    return lens.cx == lens.width / 2 and lens.cy == lens.height / 2


def _free(lens: Intrinsics) -> tuple[str, tuple[str, ...]]:
    """COLMAP's camera model that was adjusted, and what its parameters are called here."""
    if lens.fx != lens.fy or any(lens.distortion[2:]):
        return "OPENCV", PARAMETERS
    if lens.distortion[1]:
        return "RADIAL", ("f", "cx", "cy", "k1", "k2")
    return "SIMPLE_RADIAL", ("f", "cx", "cy", "k1")


def _sigmas(component: Component, lenses: list[Intrinsics]) -> list[dict[str, float | None]]:
    """Standard deviations of each lens.

    The focal length's is that of its profile where there is one, since the formal one is too small (see
    `reconstruct.calibration`); the others are formal, of the adjustment's covariance with all parameters of the lens.
    """
    found = [dict.fromkeys(PARAMETERS) for _ in lenses]
    formal = _formal(component, lenses) if 2 <= len(component.cameras) <= MAX_CAMERAS else {}
    calibration = component.calibration
    for k, lens in enumerate(lenses):
        own: dict[str, float | None] = dict(found[k])
        for name, value in formal.get(k, {}).items():
            own |= dict.fromkeys(("fx", "fy") if name == "f" else (name,), value)
        if calibration is not None:
            own |= {"fx": calibration.focal_sigma * lens.fx, "fy": calibration.focal_sigma * lens.fy}
        found[k] = own
    return found


def _formal(component: Component, lenses: list[Intrinsics]) -> dict[int, dict[str, float]]:
    """Formal standard deviations by the number of the lens, for pixel errors of the size of the residuals."""
    reconstruction, of_id = _thinned(component, lenses)
    if not reconstruction.num_points3D():
        return {}
    principal = not any(_centred(lens) for lens in lenses)
    try:
        covariance = _covariance(reconstruction, principal_point=principal)
    except (ValueError, RuntimeError):  # of COLMAP: the run is done, and must not be lost for want of this figure
        return {}
    if covariance is None:
        return {}
    noise_px, sigmas = _noise_px(reconstruction), {}
    for camera_id, number in of_id.items():
        names = [name for name in _free(lenses[number])[1] if principal or name not in ("cx", "cy")]
        block = covariance.get_other_params_cov(reconstruction.camera(camera_id).params)
        if block is not None and block.shape == (len(names), len(names)) and (np.diag(block) > 0).all():
            sigmas[number] = dict(zip(names, (noise_px * np.sqrt(np.diag(block))).tolist(), strict=True))
    return sigmas


def _thinned(component: Component, lenses: list[Intrinsics]) -> tuple[pycolmap.Reconstruction, dict[int, int]]:
    """The longest tracks in COLMAP's form with the lenses as they were adjusted, and their numbers by COLMAP's ids."""
    whole = colmap_from_component(component)
    of_id = {whole.image(k + 1).camera_id: lenses.index(one.intrinsics) for k, one in enumerate(component.cameras)}
    for camera_id, number in of_id.items():
        _as_adjusted(whole.camera(camera_id), lenses[number])
    reconstruction = thin(whole)
    for point_id in [k for k, point in reconstruction.points3D.items() if point.track.length() < 2]:
        reconstruction.delete_point3D(point_id)
    reconstruction.update_point_3d_errors()
    return reconstruction, of_id


def _covariance(reconstruction: pycolmap.Reconstruction, *, principal_point: bool) -> Any:
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in reconstruction.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False, refine_principal_point=principal_point)
    options.ceres.solver_options.num_threads = 1
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
    requested = pycolmap.BACovarianceOptions(params=pycolmap.BACovarianceOptionsParams.ALL)
    return pycolmap.estimate_ba_covariance(requested, reconstruction, adjuster)


def _noise_px(reconstruction: pycolmap.Reconstruction) -> float:
    """A-posteriori standard deviation of an image coordinate: squared residuals over the redundancy."""
    n_observations, n_points = reconstruction.compute_num_observations(), reconstruction.num_points3D()
    unknowns = 6 * reconstruction.num_reg_images() + 3 * n_points - 7  # without the similarity that no pixel fixes
    return float(rms_px(reconstruction) * np.sqrt(n_observations / max(2 * n_observations - unknowns, 1)))


def _as_adjusted(camera: pycolmap.Camera, lens: Intrinsics) -> None:
    """Give a camera of COLMAP the model that was adjusted: more parameters would be less well determined."""
    model, _ = _free(lens)
    if model != "OPENCV":
        camera.model = getattr(pycolmap.CameraModelId, model)
        camera.params = [lens.fx, lens.cx, lens.cy, *lens.distortion[: 2 if model == "RADIAL" else 1]]
