# SPDX-License-Identifier: Apache-2.0
"""Who or what carries the camera of a ground group under real conditions: a hand, a vehicle, or poles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skymoor.geometry import Intrinsics
from skymoor.simulate.capture.aim import make_lens
from skymoor.simulate.light.motion import STILL, Motion
from skymoor.simulate.light.photo import Sensor
from skymoor.simulate.mesh import stream
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.plan import Array

Kind = Literal["phone", "dash camera", "pole cameras"]

KIND_SHARES: dict[Kind, float] = {"phone": 0.45, "dash camera": 0.35, "pole cameras": 0.2}
EYE_M: dict[Kind, tuple[float, float]] = {"phone": (1.3, 1.9), "dash camera": (1.2, 3.5), "pole cameras": (2.5, 4.0)}
STEP_M: dict[Kind, tuple[float, float]] = {"phone": (1.2, 3.0), "dash camera": (1.5, 4.0), "pole cameras": (1.5, 4.0)}
FOCAL_WIDTHS: dict[Kind, tuple[float, float]] = {
    "phone": (0.70, 0.85),
    "dash camera": (0.50, 0.70),
    "pole cameras": (0.55, 0.80),
}
K1: dict[Kind, tuple[float, float]] = {
    "phone": (-0.02, 0.06),
    "dash camera": (-0.2, -0.05),
    "pole cameras": (-0.2, -0.05),
}
BLURRED_SHARE: dict[Kind, float] = {"phone": 0.5, "dash camera": 0.65, "pole cameras": 0.0}
SMALLEST_WIDTH = 472
SIDE_DEG = (20.0, 60.0)  # between the direction of travel and the axis of a dash camera
WALK_M_S, DRIVE_M_S = (0.2, 1.5), (4.0, 11.0)
READOUT_S: dict[Kind, tuple[float, float]] = {
    "phone": (0.015, 0.03),
    "dash camera": (0.01, 0.025),
    "pole cameras": (0, 0),
}
HAND_DEG_S, MOUNT_DEG_S = (7.0, 11.0, 4.0), (1.5, 2.0, 1.0)  # deviations of the rates of rotation
LONGEST_BLUR_PX = 4.0
JPEG_QUALITY = (60, 93)


@dataclass(frozen=True)
class Carrier:
    """What is the same for all photos of a group.

    Attributes:
        kind: what carries the camera.
        eye_m: height above the ground; poles differ by up to 0.4 m from it.
        width_px: of the photos.
        side_deg: of a dash camera, from the direction of travel towards the facades.
        reverse: clockwise round buildings, facades on the right.
        on_roads: a vehicle drives along roads first, and past fronts when they are used up.
        speed_m_s: of the vehicle.
        readout_s: of the rolling shutter.
        defocus_px: standard deviation of the lens's blur.
        drift: amplitude of the exposure's slow change, as a share.
    """

    kind: Kind
    eye_m: float
    width_px: int
    side_deg: float
    reverse: bool
    on_roads: bool
    speed_m_s: float
    readout_s: float
    defocus_px: float
    drift: float


def carrier_of(options: SiteOptions, group: int) -> Carrier:
    """The carrier of a group, drawn from the options alone."""
    rng = stream(options.key, "carrier", group)
    kind = list(KIND_SHARES)[int(rng.choice(len(KIND_SHARES), p=list(KIND_SHARES.values())))]
    narrowest = min(SMALLEST_WIDTH, options.photo_width)
    return Carrier(
        kind=kind,
        eye_m=round(float(rng.uniform(*EYE_M[kind])), 3),
        # Heights are three quarters, so widths are multiples of four.
        width_px=int(rng.integers(narrowest // 4, options.photo_width // 4 + 1)) * 4,
        side_deg=round(float(rng.uniform(*SIDE_DEG)), 1),
        reverse=bool(rng.uniform() < 0.5),
        on_roads=kind == "dash camera" and bool(rng.uniform() < 0.5),
        speed_m_s=round(float(rng.uniform(*DRIVE_M_S)), 2),
        readout_s=round(float(rng.uniform(*READOUT_S[kind])), 4),
        defocus_px=round(float(rng.uniform(0.45, 1.1)), 2),
        drift=round(float(rng.uniform(0.1, 0.3)), 2),
    )


def lens_of(options: SiteOptions, carrier: Carrier, rng: np.random.Generator) -> Intrinsics:
    """The lens of all photos of a group."""
    k1, focal = float(rng.uniform(*K1[carrier.kind])), float(rng.uniform(*FOCAL_WIDTHS[carrier.kind]))
    # The second term keeps a barrel growing out to any radius.
    k2 = 0.7 * k1**2 if k1 < -0.02 else float(rng.uniform(-0.06, 0.0))
    return make_lens(replace(options, photo_width=carrier.width_px), rng, focal, (k1, k2, 0.0, 0.0))


def motion_of(carrier: Carrier, travel: Array, rng: np.random.Generator) -> Motion:
    """How the camera moves during a photo; `travel` (2,) is the unit direction east, north in which it is carried."""
    if carrier.kind == "pole cameras":
        return STILL
    driven = carrier.kind == "dash camera"
    speed = carrier.speed_m_s * rng.uniform(0.7, 1.1) if driven else rng.uniform(*WALK_M_S)
    turn = rng.normal(scale=MOUNT_DEG_S if driven else HAND_DEG_S)
    blurred = rng.uniform() < BLURRED_SHARE[carrier.kind]
    blur = float(rng.uniform(0.0, LONGEST_BLUR_PX))
    east, north = (float(x) for x in speed * travel)
    return Motion(
        velocity_m_s=(east, north, 0.0),
        turn_deg_s=(float(turn[0]), float(turn[1]), float(turn[2])),
        readout_s=carrier.readout_s,
        blur_px=blur if blurred else 0.0,
    )


def sensors_of(carrier: Carrier, count: int, rng: np.random.Generator) -> list[Sensor]:
    """Sensors of a group's photos in the order in which they are taken: exposure drifts along the way."""
    exposure, red, blue = (float(x) for x in (rng.uniform(0.9, 1.2), *rng.uniform(0.93, 1.07, 2)))
    noise, quality = float(rng.uniform(0.01, 0.03)), int(rng.integers(JPEG_QUALITY[0], JPEG_QUALITY[1] + 1))
    phase, waves = rng.uniform(), rng.uniform(0.7, 2.5)
    found = []
    for k in range(count):
        drift = 1 + carrier.drift * np.sin(2 * np.pi * (waves * k / max(count - 1, 1) + phase))
        gain, defocus = float(exposure * drift * rng.uniform(0.95, 1.05)), carrier.defocus_px * rng.uniform(0.9, 1.4)
        found.append(Sensor(gain, (red, 1.0, blue), blur_px=float(defocus), noise=noise, quality=quality))
    return found
