# SPDX-License-Identifier: Apache-2.0
"""Hypothesis strategies for the nouns of skymoor."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity

Array = NDArray[np.float64]


def _vectors(limit: float) -> st.SearchStrategy[Array]:
    number = st.floats(-limit, limit, allow_nan=False)
    return st.tuples(number, number, number).map(lambda values: np.array(values, dtype=np.float64))


def points(limit: float = 100.0) -> st.SearchStrategy[Array]:
    """Clouds (n, 3) of 1 to 8 points, single ones and equal ones too."""
    return st.lists(_vectors(limit), min_size=1, max_size=8).map(np.array)


def similarities() -> st.SearchStrategy[Similarity]:
    """Similarities from near the identity to half turns, scales 0.01 to 100, translations to 1 km."""
    rotvecs = st.one_of(_vectors(np.pi), _vectors(1e-9), st.sampled_from(list(np.pi * np.eye(3))))
    scales = st.one_of(st.floats(-2.0, 2.0).map(lambda power: 10.0**power), st.floats(1.0 - 1e-9, 1.0 + 1e-9))
    return st.builds(
        lambda scale, rotvec, translation: Similarity(scale, Rotation.from_rotvec(rotvec).as_matrix(), translation),
        scales,
        rotvecs,
        st.one_of(_vectors(1000.0), _vectors(1e-9)),
    )
