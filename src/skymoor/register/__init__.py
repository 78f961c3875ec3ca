# SPDX-License-Identifier: Apache-2.0
"""Where a model is on Earth, how well that is known, and whether to believe it."""

from skymoor.register.airborne import RegisterOptions, independent_cells, register, restated, with_covariance_of
from skymoor.register.chance import chance_probability, height_agreement
from skymoor.register.covariance import CameraAccuracy, camera_accuracy
from skymoor.register.ground import (
    Candidate,
    Guess,
    JudgeOptions,
    PoolOptions,
    judge_ground,
    pool_guesses,
)
from skymoor.register.refusal import judge
from skymoor.register.relief import Relief, ReliefOptions, compare_relief, focal_correction

__all__ = [
    "CameraAccuracy",
    "Candidate",
    "Guess",
    "JudgeOptions",
    "PoolOptions",
    "RegisterOptions",
    "Relief",
    "ReliefOptions",
    "camera_accuracy",
    "chance_probability",
    "compare_relief",
    "focal_correction",
    "height_agreement",
    "independent_cells",
    "judge",
    "judge_ground",
    "pool_guesses",
    "register",
    "restated",
    "with_covariance_of",
]
