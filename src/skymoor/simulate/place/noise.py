# SPDX-License-Identifier: Apache-2.0
"""Random fields fixed to places, so that a near and a far page, or two seasons, show the same spots."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.simulate.mesh import stream

Array32 = NDArray[np.float32]


def field(seed: int, name: str, wave_m: float, half_m: float, size: int, *, extent_m: float) -> Array32:
    """Smooth noise (size, size) of mean 0 and deviation about 1 over the square within `half_m` of the origin.

    `wave_m` is its shortest wavelength. The lattice behind it covers `extent_m` and depends on nothing else: two
    calls show the same field at any resolution.
    """
    cells = int(np.ceil(2 * extent_m / (wave_m / 2))) + 8
    lattice = stream(seed, name, round(wave_m * 1000)).standard_normal((cells, cells), dtype=np.float32)
    step = 2 * half_m / size / (wave_m / 2)
    first = cells / 2 - half_m / (wave_m / 2) + step / 2 - 0.5
    # warpAffine counts pixel centres from 0 and asks for the source of each target pixel.
    matrix = np.array([[step, 0, first], [0, step, first]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    smooth = cv2.warpAffine(lattice, matrix, (size, size), flags=flags, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(1.3 * smooth, dtype=np.float32)


def periodic(rng: np.random.Generator, size: int, smallest_px: float, slope: float = 1.5) -> Array32:
    """Noise (size, size) that repeats, mean 0 and deviation 1, its spectrum falling with `slope`."""
    spectrum = np.fft.rfft2(rng.standard_normal((size, size)))
    fy, fx = np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None]
    f = np.hypot(fx, fy)
    f[0, 0] = np.inf
    shaped = spectrum * f**-slope * np.exp(-((f * smallest_px) ** 2))
    shaped[0, 0] = 0
    made = np.fft.irfft2(shaped, (size, size))
    return np.asarray(made / made.std(), dtype=np.float32)
