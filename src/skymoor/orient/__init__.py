# SPDX-License-Identifier: Apache-2.0
"""Which way is up in a reconstruction."""

from skymoor.orient.gravity import OrientOptions, estimate_gravity, level_from_gravity
from skymoor.orient.labels import ground_points
from skymoor.orient.protocol import GroundLabeler

__all__ = ["GroundLabeler", "OrientOptions", "estimate_gravity", "ground_points", "level_from_gravity"]
