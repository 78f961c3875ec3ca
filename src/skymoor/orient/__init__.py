# SPDX-License-Identifier: Apache-2.0
"""Gravity direction of a reconstruction."""

from skymoor.orient._oneformer import OneFormerLabeler
from skymoor.orient._semantic import SemanticLabeler
from skymoor.orient.gravity import OrientOptions, estimate_gravity, level_from_gravity
from skymoor.orient.labels import ground_points
from skymoor.orient.protocol import GroundLabeler
from skymoor.orient.upright import UprightOptions, estimate_ground_gravity

__all__ = [
    "GroundLabeler",
    "OneFormerLabeler",
    "OrientOptions",
    "SemanticLabeler",
    "UprightOptions",
    "estimate_gravity",
    "estimate_ground_gravity",
    "ground_points",
    "level_from_gravity",
]
