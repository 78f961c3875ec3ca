# SPDX-License-Identifier: Apache-2.0
"""Buildings: walls with modelled windows and doors, roofs, and what changes on them from day to day."""

from skymoor.simulate.building.assemble import daily_parts, fixed_parts

__all__ = ["daily_parts", "fixed_parts"]
