# SPDX-License-Identifier: Apache-2.0
"""Whole sites with exact truth: photos from the air and from the ground, an orthophoto and a DSM of another day.

`World(SiteOptions(...))` of `world` is a site, `write_site` of `site` puts it on the disk. Only the options are loaded
with the package, since the command line's help shows them.
"""

from skymoor.simulate.building.assemble import daily_parts, fixed_parts
from skymoor.simulate.capture.shots import Shot, airborne_shots, ground_shots, security_shots, true_view
from skymoor.simulate.options import SiteOptions

__all__ = [
    "Shot",
    "SiteOptions",
    "airborne_shots",
    "daily_parts",
    "fixed_parts",
    "ground_shots",
    "security_shots",
    "true_view",
]
