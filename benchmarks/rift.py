# SPDX-License-Identifier: Apache-2.0
"""A baseline in the manner of RIFT: key points and descriptors from phase congruency instead of grey values.

Li, Hu and Ai, *RIFT: Multi-modal image matching based on radiation-variation insensitive feature transform* (IEEE TIP
2020): a log-Gabor bank, corners of the phase congruency, and for each of them histograms of the orientation whose
response is largest (the maximum index map), in 6 x 6 cells. Written from the paper; its rotation invariance by cyclic
shifts of the map is not, so that headings have to be tried. Phase congruency as in Kovesi (1999), simplified.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SCALES, ORIENTATIONS = 4, 6
WAVELENGTH_PX, RATIO, BANDWIDTH = 3.0, 1.6, 0.75
CELL_PX, CELLS = 16, 6
NOISE = 2.0  # standard deviations of the smallest scale's response
KEYPOINTS = 2000


def rift_features(grey: NDArray[np.uint8], mask: NDArray[np.bool_]) -> tuple[Array, NDArray[np.float32]]:
    """Key points (n, 2), the centre of the first pixel at (0.5, 0.5), and descriptors (n, 216) of length 1."""
    amplitude, corners = _congruency(grey)
    strength = cv2.normalize(corners, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((9, 9), np.uint8))
    points = cv2.FastFeatureDetector_create(threshold=3).detect(strength, inner)
    points = sorted(points, key=lambda point: -point.response)[:KEYPOINTS]
    px = np.array([point.pt for point in points], np.float64).reshape(-1, 2) + 0.5
    return px, _described(amplitude.argmax(axis=0), mask, px)


def _congruency(grey: NDArray[np.uint8]) -> tuple[Array, Array]:
    """Amplitude (orientations, h, w) summed over scales, and the larger moment (h, w) of phase congruency."""
    spectrum = np.fft.fft2(grey.astype(np.float64))
    amplitudes, xx, yy, xy = [], 0.0, 0.0, 0.0
    for k, filters in enumerate(_bank(grey.shape[0], grey.shape[1])):
        responses = np.fft.ifft2(spectrum * filters)
        sizes = np.abs(responses)
        total = sizes.sum(axis=0)
        noise = NOISE * np.median(sizes[0]) * np.sqrt(SCALES)
        congruency = np.maximum(np.abs(responses.sum(axis=0)) - noise, 0) / (total + 1e-3)
        c, s = np.cos(k * np.pi / ORIENTATIONS), np.sin(k * np.pi / ORIENTATIONS)
        xx, yy, xy = xx + (congruency * c) ** 2, yy + (congruency * s) ** 2, xy + congruency**2 * c * s
        amplitudes.append(total)
    moment = 0.5 * (xx + yy + np.sqrt((xx - yy) ** 2 + 4 * xy**2))
    return np.array(amplitudes), np.asarray(moment)


@lru_cache(maxsize=3)
def _bank(h: int, w: int) -> Array:
    """Log-Gabor filters (orientations, scales, h, w) in the frequency domain."""
    v, u = np.meshgrid(np.fft.fftfreq(h), np.fft.fftfreq(w), indexing="ij")
    radius, angle = np.hypot(u, v), np.arctan2(v, u)
    radius[0, 0] = 1.0
    low_pass = 1 / (1 + (radius / 0.45) ** 30)
    bank = np.empty((ORIENTATIONS, SCALES, h, w))
    for k in range(ORIENTATIONS):
        off = np.angle(np.exp(1j * (angle - k * np.pi / ORIENTATIONS)))
        spread = 0.5 * (np.cos(np.clip(np.abs(off) * ORIENTATIONS / 2, 0, np.pi)) + 1)
        for n in range(SCALES):
            centre = 1 / (WAVELENGTH_PX * RATIO**n)
            radial = np.exp(-(np.log(radius / centre) ** 2) / (2 * np.log(BANDWIDTH) ** 2)) * low_pass
            radial[0, 0] = 0.0
            bank[k, n] = radial * spread
    return bank


def _described(index: NDArray[np.intp], mask: NDArray[np.bool_], px: Array) -> NDArray[np.float32]:
    """Histograms of the index map in cells about each point; cells beyond the mask are empty."""
    reach = CELL_PX * CELLS // 2
    counts = [cv2.blur(((index == k) & mask).astype(np.float32), (CELL_PX, CELL_PX)) for k in range(ORIENTATIONS)]
    padded = np.pad(np.array(counts), ((0, 0), (reach, reach), (reach, reach)))
    offsets = (np.arange(CELLS) - (CELLS - 1) / 2) * CELL_PX + reach
    columns = np.floor(px[:, 0, None] + offsets).astype(int)
    rows = np.floor(px[:, 1, None] + offsets).astype(int)
    found = padded[:, rows[:, :, None], columns[:, None, :]]  # orientations, n, cells, cells
    flat = found.transpose(1, 2, 3, 0).reshape(len(px), -1)
    return (flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6)).astype(np.float32)
