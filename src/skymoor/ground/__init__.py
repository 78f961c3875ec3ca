# SPDX-License-Identifier: Apache-2.0
"""Ground photos onto the airborne model (paper, section 3.4): by walls, by tiles, all decided together."""

from skymoor.ground.hypotheses import Hypotheses, OneHypothesis
from skymoor.ground.joint import JointOptions, conflict, decide_jointly

__all__ = ["Hypotheses", "JointOptions", "OneHypothesis", "conflict", "decide_jointly"]
