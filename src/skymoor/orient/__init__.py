# SPDX-License-Identifier: Apache-2.0
"""Which way is up in a reconstruction."""

from skymoor.orient.gravity import OrientOptions, estimate_gravity, level_from_gravity

__all__ = ["OrientOptions", "estimate_gravity", "level_from_gravity"]
