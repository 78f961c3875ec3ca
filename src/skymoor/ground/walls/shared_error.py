# SPDX-License-Identifier: Apache-2.0
"""The error that all matches of a ground component with airborne walls share, and that their residuals do not show."""

from __future__ import annotations

from dataclasses import replace

from skymoor.types import Registration

WALL_SIGMA_M = 0.5
"""Of each horizontal axis. Walls below roof edges stand where the eaves end, airborne depths round the edges off, and a
walk sees one or two walls, so the matches move together. It is the root mean square of the own error of six placed
components of simulated sites (docs/benchmarks.md), whose formal covariance was a quarter of it; and it is not proven
on others."""
EAST_NORTH = (4, 5)  # of the covariance: logarithm of scale, three rotations, east, north, up


def with_shared_error(found: Registration) -> Registration:
    """The registration with the shared error of its walls in its covariance."""
    if found.covariance is None:
        return found
    covariance = found.covariance.copy()
    covariance[EAST_NORTH, EAST_NORTH] += WALL_SIGMA_M**2
    return replace(found, covariance=covariance)
