# SPDX-License-Identifier: Apache-2.0
"""Masked normalised cross-correlation of channel stacks by FFT (Padfield 2012)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from skymoor.match.channels import Channels
from skymoor.types import Array32

_WORKERS = os.cpu_count() or 1


@dataclass(frozen=True, eq=False)
class Target:
    """A reference whose spectra are computed once per padded size."""

    channels: Channels
    _spectra: dict[tuple[int, int], NDArray[np.complex64]] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        h, w = self.channels.values.shape[1:]
        return h, w

    def spectra(self, size: tuple[int, int]) -> NDArray[np.complex64]:
        """Spectra (n + 2, ...) of the n channels, of their energy, and of the mask of known colour."""
        if size not in self._spectra:
            values = self.channels.values
            stack = np.concatenate([values, (values**2).sum(axis=0)[None], self.channels.known[:1]])
            self._spectra[size] = fft.rfft2(stack, s=size, workers=_WORKERS)
        return self._spectra[size]


def correlate(template: Channels, target: Target, *, min_overlap: float, valid: bool = False) -> Array32:
    """Scores of all shifts of a template over a target.

    The score is NCC times the square root of the overlap in pixels: about the number of standard deviations of
    unrelated content. It is minus infinity where less than the fraction `min_overlap` of the template's known pixels
    lies on known pixels of the target.

    Returns:
        (h, w) whose element (v, u) has the template's first pixel at (v - th + 1, u - tw + 1) of the target; with
        `valid` only shifts that keep the template inside, and its first pixel is at (v, u).
    """
    th, tw = template.values.shape[1:]
    full = (target.shape[0] + th - 1, target.shape[1] + tw - 1)
    used = target.shape if valid else full  # wrapped values fall outside the valid part
    size = (fft.next_fast_len(used[0], real=True), fft.next_fast_len(used[1], real=True))
    reference = target.spectra(size)
    stack = np.concatenate([template.values, template.known[:1]])
    # Correlation is convolution with the template rotated by 180 degrees.
    template_spectra = _padded_spectra(np.ascontiguousarray(stack[:, ::-1, ::-1]), size)
    products = np.empty((3, *template_spectra.shape[1:]), np.complex64)
    np.multiply(template_spectra[0], reference[0], out=products[0])
    for k in range(1, len(template_spectra) - 1):
        products[0] += template_spectra[k] * reference[k]
    products[1] = template_spectra[-1] * reference[-2]
    products[2] = template_spectra[-1] * reference[-1]
    maps = fft.irfft2(products, s=size, workers=_WORKERS, overwrite_x=True)
    window = (
        (slice(th - 1, target.shape[0]), slice(tw - 1, target.shape[1])) if valid else (slice(full[0]), slice(full[1]))
    )
    numerator, energy, overlap = maps[(slice(None), *window)]
    area = float(template.known[0].sum())
    template_energy = float((template.values**2).sum()) * np.maximum(overlap, 0) / max(area, 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        score = numerator / np.sqrt(np.maximum(template_energy * energy, 1e-6)) * np.sqrt(np.maximum(overlap, 0))
    score[(overlap < max(min_overlap * area, 100)) | (energy < 1e-3 * float(energy.max()))] = -np.inf
    return np.asarray(score, dtype=np.float32)


def _padded_spectra(stack: Array32, size: tuple[int, int]) -> NDArray[np.complex64]:
    """`fft.rfft2` at this size; the rows that padding adds are not transformed, for they are zero."""
    rows = fft.rfft(stack, size[1], workers=_WORKERS)
    spectra: NDArray[np.complex64] = fft.fft(rows, size[0], axis=-2, workers=_WORKERS)
    return spectra


def peaks(surface: Array32, *, count: int, apart: int) -> Iterator[tuple[float, float, float]]:
    """The highest peaks (v, u, score) with subpixel positions, at least `apart` pixels from each other."""
    surface = surface.copy()
    for _ in range(count):
        v, u = divmod(int(np.argmax(surface)), surface.shape[1])
        score = float(surface[v, u])
        if not np.isfinite(score):
            return
        yield v + parabola(surface[max(0, v - 1) : v + 2, u]), u + parabola(surface[v, max(0, u - 1) : u + 2]), score
        surface[max(0, v - apart) : v + apart + 1, max(0, u - apart) : u + apart + 1] = -np.inf


def parabola(three: Array32) -> float:
    """Vertex of the parabola through three values, in steps from the middle one; 0 if there is no maximum."""
    if len(three) != 3 or not np.isfinite(three).all():
        return 0.0
    curvature = float(three[0] - 2 * three[1] + three[2])
    return float(np.clip(0.5 * (three[0] - three[2]) / curvature, -0.5, 0.5)) if curvature < 0 else 0.0
