# SPDX-License-Identifier: Apache-2.0
"""Pixels to points."""

from skymoor.lift.lift import LiftOptions, lift

__all__ = ["LiftOptions", "lift"]
