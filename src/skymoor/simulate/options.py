# SPDX-License-Identifier: Apache-2.0
"""Options of a simulated site."""

from __future__ import annotations

import zlib
from dataclasses import asdict, dataclass
from typing import Literal

from skymoor.errors import InputError

Preset = Literal["office-park", "industrial", "flooded", "hillside", "old-houses"]


@dataclass(frozen=True)
class SiteOptions:
    """A site is made from these alone: the same options give the same site.

    Attributes:
        preset: the kind of site. The first three are after the sites of the paper's results: A01, M07 and A08;
            hillside has hills of 30 m, old-houses has roofs under old trees.
        seed: of everything random; other seeds are other places.
        radius_m: of the part that is modelled in full; the rest is plainer.
        airborne: number of airborne photos.
        groups: disjoint walks of ground photos, each round another building.
        group_photos: photos of each walk; many go all the way round.
        security: photos of security cameras, with strong distortion.
        photo_width: pixels; the height is three quarters of it.
        samples: rays per pixel, per side.
        reference_width_m: side of the square that the orthophoto and the DSM cover.
        ortho_pixel_m: pixel of the orthophoto.
        dsm_pixel_m: pixel of the DSM.
        ce90_m: circular error of the reference, 90 %, from which its bias is drawn; by default the paper's.
        le90_m: vertical error of the reference, 90 %; by default the paper's.
        off_nadir_deg: by how much buildings lean in the orthophoto.
        look_alikes: "facades" repeats the bays of each facade; "twins" also builds one building twice.
        depths: write the true depth of every photo.
        labels: write what every pixel of every photo shows.
        conditions: of the ground photos and facades. "real" draws a phone, a dash camera or cameras on poles for
            each group, walks with gaps and quick turns, photos blurred by motion and skewed by the rolling shutter,
            repeated, glazed and plain facades, half of those walked in shade, with trees, hedges and cars before
            them, and another season than in the air.
        flight: "orbits" looks straight down and from all sides at 45 degrees or steeper; "grid" is a flight for mapping
            at 60 to 100 m.
        tilt_deg: of the cameras of a grid, forward from nadir.
    """

    preset: Preset = "office-park"
    seed: int = 0
    radius_m: float = 85.0
    airborne: int = 50
    groups: int = 2
    group_photos: int = 11
    security: int = 8
    photo_width: int = 1000
    samples: int = 2
    reference_width_m: float = 400.0
    ortho_pixel_m: float = 0.4
    dsm_pixel_m: float = 0.5
    ce90_m: float | None = None
    le90_m: float | None = None
    off_nadir_deg: float = 0.0
    look_alikes: Literal["none", "facades", "twins"] = "none"
    depths: bool = False
    labels: bool = False
    conditions: Literal["easy", "real"] = "easy"
    flight: Literal["orbits", "grid"] = "orbits"
    tilt_deg: float = 15.0

    @property
    def key(self) -> int:
        """The seed of the random streams: presets of one seed have nothing in common."""
        return zlib.crc32(f"{self.preset} {self.seed}".encode())

    @property
    def real(self) -> bool:
        """Whether ground photos and facades are as in the real world."""
        return self.conditions == "real"

    @property
    def written(self) -> dict[str, object]:
        """The options as truth.json holds them: a site made before a later option existed stays the same site."""
        return {name: value for name, value in asdict(self).items() if LATER.get(name) != value}

    def __post_init__(self) -> None:
        for name, (low, high) in BOUNDS.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise InputError(f"{name} = {value}: give a number from {low} to {high}")


BOUNDS = {
    "radius_m": (20, 500),
    "airborne": (3, 5000),
    "groups": (0, 26),
    "group_photos": (1, 500),
    "security": (0, 500),
    "photo_width": (16, 8000),
    "samples": (1, 4),
    "reference_width_m": (20, 6000),
    "ortho_pixel_m": (0.05, 10),
    "dsm_pixel_m": (0.1, 20),
    "ce90_m": (1e-6, 100),
    "le90_m": (1e-6, 100),
    "off_nadir_deg": (0, 60),
    "tilt_deg": (5, 25),
}
LATER = {"conditions": "easy", "flight": "orbits", "tilt_deg": 15.0}  # options of later versions, with their defaults
