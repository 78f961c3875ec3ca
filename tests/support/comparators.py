# SPDX-License-Identifier: Apache-2.0
"""Comparisons that fail with a sentence."""

from __future__ import annotations

import numpy as np

from skymoor.geometry import Similarity


def assert_similarity_near(
    actual: Similarity, expected: Similarity, *, rot_deg: float, trans_m: float, scale_ppm: float
) -> None:
    """Compare angle of the rotation between, distance of the translations and ratio of the scales."""
    # From the chord of the rotation, as the arc cosine of a trace is blind below 1e-6 degrees.
    chord = np.linalg.norm(actual.rotation - expected.rotation) / np.sqrt(8.0)
    angle_deg = float(np.degrees(2.0 * np.arcsin(min(1.0, float(chord)))))
    distance_m = float(np.linalg.norm(actual.translation - expected.translation))
    ppm = abs(actual.scale / expected.scale - 1.0) * 1e6
    complaints = [
        f"{name} differs by {value:.4g} {unit}, more than {limit:.4g} {unit}"
        for name, value, limit, unit in (
            ("rotation", angle_deg, rot_deg, "deg"),
            ("translation", distance_m, trans_m, "m"),
            ("scale", ppm, scale_ppm, "ppm"),
        )
        if not value <= limit
    ]
    assert not complaints, "the similarities are not near: " + "; ".join(complaints)
