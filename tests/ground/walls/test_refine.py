# SPDX-License-Identifier: Apache-2.0
"""A perturbed pose is refined to the maximum of the score."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity
from skymoor.ground.walls.refine import PerturbationOptions, RefineOptions, perturbed, refine_pose

RNG = np.random.default_rng(3)
# A wall in the level frame, and where it truly stands.
POINTS = np.column_stack([RNG.uniform(-8, 8, 60), RNG.uniform(14, 20, 60), RNG.uniform(0, 7, 60)])
TRUE = Similarity(1.6, Rotation.from_euler("z", 70, degrees=True).as_matrix(), np.array([210.0, -40.0, 2.0]))


def score(place: Similarity) -> float:
    """High where points lie on points, flat where they are a metre apart."""
    gaps = np.linalg.norm(place.apply(POINTS) - TRUE.apply(POINTS), axis=1)
    return float(50 * np.exp(-0.5 * (gaps / 0.6) ** 2).mean())


def off_by(east_m: float, rotation_deg: float, scale: float) -> Similarity:
    pivot = TRUE.apply(POINTS).mean(axis=0)
    turn = Rotation.from_euler("z", rotation_deg, degrees=True).as_matrix()
    move = np.array([east_m, -east_m / 2, 0.2])
    return Similarity(scale, turn, pivot + move - scale * turn @ pivot) @ TRUE


@pytest.mark.parametrize(("east_m", "rotation_deg", "scale"), [(0.5, 1.0, 1.02), (-0.7, -0.5, 0.97), (0.0, 0.0, 1.0)])
def test_the_best_pose_is_recovered(east_m: float, rotation_deg: float, scale: float) -> None:
    start, tried = off_by(east_m, rotation_deg, scale), []

    def counted(place: Similarity) -> float:
        tried.append(place)
        return score(place)

    found = refine_pose(start, start.apply(POINTS).mean(axis=0), counted, RefineOptions(trials=80))
    gaps = np.linalg.norm(found.apply(POINTS) - TRUE.apply(POINTS), axis=1)
    assert gaps.mean() < 0.12
    assert score(found) >= score(start)
    assert len(tried) <= 2 * (80 + 5)


def test_perturbed_poses_lie_all_around() -> None:
    places = perturbed(TRUE, PerturbationOptions(count=16, min_m=2.0, max_m=4.0))
    moves = np.array([place.translation - TRUE.translation for place in places])
    lengths = np.linalg.norm(moves, axis=1)
    assert (lengths.min(), lengths.max()) == (pytest.approx(2.0), pytest.approx(4.0))
    assert not moves[:, 2].any()
    assert all(place.scale == TRUE.scale for place in places)
    headings = np.sort(np.degrees(np.arctan2(moves[:, 1], moves[:, 0])))
    assert np.diff(headings).max() < 45
