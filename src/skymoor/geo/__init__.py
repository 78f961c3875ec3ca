# SPDX-License-Identifier: Apache-2.0
"""Earth: the local frame, grids in it, vertical datums and accuracy figures."""

from skymoor.geo.accuracy import (
    UNKNOWN_ACCURACY,
    UNKNOWN_HEIGHT_SIGMA_M,
    ce90_m,
    checked_covariance,
    covariance_from_ce90_le90,
    le90_m,
    mahalanobis,
)
from skymoor.geo.datum import ellipsoidal_heights, vertical_datum_of
from skymoor.geo.frame import EnuFrame
from skymoor.geo.grid import Grid, sample

__all__ = [
    "UNKNOWN_ACCURACY",
    "UNKNOWN_HEIGHT_SIGMA_M",
    "EnuFrame",
    "Grid",
    "ce90_m",
    "checked_covariance",
    "covariance_from_ce90_le90",
    "ellipsoidal_heights",
    "le90_m",
    "mahalanobis",
    "sample",
    "vertical_datum_of",
]
