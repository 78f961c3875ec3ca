# SPDX-License-Identifier: Apache-2.0
"""From 2D matches to a georeferenced model: lifting, registration, accuracy and acceptance (paper, section 3.3)."""

from skymoor.registration.agreement import Agreement
from skymoor.registration.airborne import (
    RegisterOptions,
    independent_cells,
    inlier_limit_m,
    register,
    restated,
    with_covariance_of,
)
from skymoor.registration.bare_earth import ground_level, is_bare_earth, raised
from skymoor.registration.covariance import SHAPE_FACTOR, CameraAccuracy, camera_accuracy, focal_motion
from skymoor.registration.height_verdict import focal_posterior, judge_heights
from skymoor.registration.heights import HeightFit, compare_heights
from skymoor.registration.lift import LiftOptions, lift
from skymoor.registration.on_map import flat_transform, place_on_map
from skymoor.registration.plan import PlanFit, fit_plan
from skymoor.registration.refusal import decide
from skymoor.registration.significance import NullSample, false_alarm_probability

__all__ = [
    "SHAPE_FACTOR",
    "Agreement",
    "CameraAccuracy",
    "HeightFit",
    "LiftOptions",
    "NullSample",
    "PlanFit",
    "RegisterOptions",
    "camera_accuracy",
    "compare_heights",
    "decide",
    "false_alarm_probability",
    "fit_plan",
    "flat_transform",
    "focal_motion",
    "focal_posterior",
    "ground_level",
    "independent_cells",
    "inlier_limit_m",
    "is_bare_earth",
    "judge_heights",
    "lift",
    "place_on_map",
    "raised",
    "register",
    "restated",
    "with_covariance_of",
]
