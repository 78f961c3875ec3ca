# SPDX-License-Identifier: Apache-2.0
"""Files of models that were given, moved to their places on Earth."""

from skymoor.results.placed.move import PLACED, place_model

__all__ = ["PLACED", "place_model"]
