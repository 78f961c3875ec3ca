# SPDX-License-Identifier: Apache-2.0
"""Whole sites with exact truth: photos from the air and from the ground, an orthophoto and a DSM of another day."""

from skymoor.simulate.plan import Date, SiteOptions
from skymoor.simulate.site import write_site
from skymoor.simulate.world import World

__all__ = ["Date", "SiteOptions", "World", "write_site"]
