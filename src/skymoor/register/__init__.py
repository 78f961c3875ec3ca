# SPDX-License-Identifier: Apache-2.0
"""Where a model is on Earth, how well that is known, and whether to believe it."""

from skymoor.register.airborne import RegisterOptions, camera_covariances, independent_cells, register, restated
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
    "Candidate",
    "Guess",
    "JudgeOptions",
    "PoolOptions",
    "RegisterOptions",
    "Relief",
    "ReliefOptions",
    "camera_covariances",
    "compare_relief",
    "focal_correction",
    "independent_cells",
    "judge",
    "judge_ground",
    "pool_guesses",
    "register",
    "restated",
]
