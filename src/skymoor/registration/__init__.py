# SPDX-License-Identifier: Apache-2.0
"""Pixels to points, points to a place on Earth, its accuracy, and whether it is accepted (paper, section 3.3)."""

from skymoor.registration.airborne import RegisterOptions, independent_cells, register, restated, with_covariance_of
from skymoor.registration.chance import false_alarm_probability, height_agreement
from skymoor.registration.covariance import CameraAccuracy, camera_accuracy
from skymoor.registration.lift import LiftOptions, lift
from skymoor.registration.refusal import decide
from skymoor.registration.relief import Relief, ReliefOptions, compare_relief, focal_correction

__all__ = [
    "CameraAccuracy",
    "LiftOptions",
    "RegisterOptions",
    "Relief",
    "ReliefOptions",
    "camera_accuracy",
    "compare_relief",
    "decide",
    "false_alarm_probability",
    "focal_correction",
    "height_agreement",
    "independent_cells",
    "lift",
    "register",
    "restated",
    "with_covariance_of",
]
