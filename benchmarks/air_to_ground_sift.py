# SPDX-License-Identifier: Apache-2.0
"""Whether plain structure from motion joins airborne and ground photos of a site: on real sites it does not.

    python benchmarks/air_to_ground_sift.py SITE_FOLDER...

Puts all photos of a site into one reconstruction and prints what each component holds. A simulated site whose air and
ground are joined by it is too easy to say anything about matching them.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

from skymoor.reconstruct import ReconstructOptions, reconstruct
from skymoor.store import open_photos
from skymoor.types import Photos


def main() -> None:
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    for site in map(Path, sys.argv[1:]):
        photos = both_sets(site)
        print(f"{site.name}: {len(photos)} photos")
        for component in reconstruct(photos, ReconstructOptions(), seed=0):
            counts = Counter(camera.image.split("/")[0] for camera in component.cameras)
            joined = "JOINED" if len(counts) > 1 else ""
            print("  " + ", ".join(f"{count} {name}" for name, count in counts.items()), joined, flush=True)


def both_sets(site: Path) -> Photos:
    """Airborne and ground photos as one set."""
    sets = {name: open_photos(site / name, site) for name in ("airborne", "ground")}
    names = tuple(name for photos in sets.values() for name in photos.names)
    sizes = tuple(size for photos in sets.values() for size in photos.sizes)
    return Photos(names, sizes, lambda name: sets[name.split("/")[0]].read(name))


if __name__ == "__main__":
    main()
