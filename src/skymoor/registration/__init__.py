# SPDX-License-Identifier: Apache-2.0
"""From 2D matches to a georeferenced model: lifting, registration, accuracy and acceptance (paper, section 3.3)."""

from skymoor.registration.airborne import RegisterOptions, independent_cells, register, restated, with_covariance_of
from skymoor.registration.covariance import CameraAccuracy, camera_accuracy
from skymoor.registration.lift import LiftOptions, lift
from skymoor.registration.refusal import decide
from skymoor.registration.relief import HeightScale, HeightScaleOptions, estimate_height_scale, focal_correction
from skymoor.registration.significance import false_alarm_probability, height_agreement

__all__ = [
    "CameraAccuracy",
    "HeightScale",
    "HeightScaleOptions",
    "LiftOptions",
    "RegisterOptions",
    "camera_accuracy",
    "decide",
    "estimate_height_scale",
    "false_alarm_probability",
    "focal_correction",
    "height_agreement",
    "independent_cells",
    "lift",
    "register",
    "restated",
    "with_covariance_of",
]
