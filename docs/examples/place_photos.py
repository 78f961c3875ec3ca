# SPDX-License-Identifier: Apache-2.0
"""Simulate a small site, register its photos, and compare with the truth: place_photos.py FOLDER."""

import sys
from pathlib import Path

import skymoor
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.site import write_site
from skymoor.simulate.world import World

# A dozen small photos: enough for every step to have its work.
SMALL = SiteOptions(
    seed=1,
    radius_m=34.0,
    airborne=12,
    groups=0,
    security=0,
    photo_width=400,
    samples=1,
    reference_width_m=120.0,
    ortho_pixel_m=0.5,
)
# A known flying height saves time, because every height is searched. Small photos contain few features.
FASTER = {"match.min_height_m": 60, "match.max_height_m": 90, "engines.sift.max_features": 2500}


def main(folder: Path, site: Path | None = None, options: dict[str, float] = FASTER) -> None:
    """Results go to FOLDER/result; without an existing `site`, one is made in FOLDER/site."""
    site = site or write_site(World(SMALL), folder / "site").toml
    result = skymoor.register(site, out=folder / "result", options=options, seed=3)
    for component in result.components:
        if component.registered:
            print(f"{component.name}: CE90 {component.ce90_m:.1f} m, LE90 {component.le90_m:.1f} m")
        else:
            print(f"{component.name}: refused: {component.reason}")
    for row in result.evaluate(site.parent / "truth.csv"):
        if row.mean_absolute_m is not None:
            print(f"{row.set}_{row.component}: estimated positions are {row.mean_absolute_m:.2f} m off, on average")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
