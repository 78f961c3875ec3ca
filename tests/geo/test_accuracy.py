# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from skymoor.errors import InputError
from skymoor.geo import ce90_m, checked_covariance, covariance_from_ce90_le90, le90_m, mahalanobis

TILTED = np.array([[4.0, 1.5, 0.3], [1.5, 1.0, -0.2], [0.3, -0.2, 5.4]])


def test_published_factors() -> None:
    covariance = covariance_from_ce90_le90(2.1460, 1.6449)
    np.testing.assert_allclose(covariance, np.eye(3), atol=1e-4)
    assert ce90_m(np.eye(3)) == pytest.approx(2.1460, abs=5e-5)
    assert le90_m(np.eye(3)) == pytest.approx(1.6449, abs=5e-5)


def test_round_trip() -> None:
    covariance = covariance_from_ce90_le90(2.8, 3.9)
    assert ce90_m(covariance) == pytest.approx(2.8, rel=1e-9)
    assert le90_m(covariance) == pytest.approx(3.9, rel=1e-9)


@pytest.mark.parametrize(
    "plan", [TILTED[:2, :2], np.diag([1.0, 1.0]), np.diag([9.0, 0.01]), np.array([[1.0, 0.999], [0.999, 1.0]])]
)
def test_ninety_percent_lie_within(plan: np.ndarray) -> None:
    n = 400_000
    errors = np.random.default_rng(0).multivariate_normal([0, 0], plan, n)
    share = np.mean(np.hypot(*errors.T) < ce90_m(plan))
    assert abs(share - 0.9) < 4 * np.sqrt(0.9 * 0.1 / n)


def test_line_is_the_limit_of_ellipses() -> None:
    for minor in (0.0, 1e-12, 1e-6):
        assert ce90_m(np.diag([4.0, minor])) == pytest.approx(2 * 1.644854, abs=1e-5)
    assert ce90_m(np.zeros((2, 2))) == 0.0


def test_ce90_does_not_depend_on_the_axes() -> None:
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    plan = np.diag([4.0, 0.5])
    assert ce90_m(turn @ plan @ turn.T) == pytest.approx(ce90_m(plan), rel=1e-12)
    assert ce90_m(9 * plan) == pytest.approx(3 * ce90_m(plan), rel=1e-12)


def test_mahalanobis_of_drawn_errors() -> None:
    errors = np.random.default_rng(1).multivariate_normal(np.zeros(3), TILTED, 20_000)
    squares = mahalanobis(errors, TILTED) ** 2
    assert 2.93 < squares.mean() < 3.07  # chi-square with 3 degrees of freedom
    assert 5.5 < squares.var() < 6.5
    np.testing.assert_allclose(mahalanobis([[2.0, 0, 0], [0, 0, 3.0]], np.diag([4.0, 1, 9])), [1, 1])


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.eye(2), "3 rows of 3"),
        ([[1, 2], [3]], "3 rows of 3"),
        ("nonsense", "3 rows of 3"),
        (np.diag([1, 1, np.nan]), "finite"),
        ([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]], "symmetric"),
        (np.diag([1, -1, 1]), "positive variances"),
        (np.diag([1, 0, 1]), "positive variances"),
        ([[1, 2, 0], [2, 1, 0], [0, 0, 1]], "positive definite"),
    ],
)
def test_covariance_is_checked(covariance: object, message: str) -> None:
    with pytest.raises(InputError, match=f"reference.covariance .*{message}"):
        checked_covariance(covariance, name="reference.covariance")  # type: ignore[arg-type]


def test_good_covariance_passes() -> None:
    np.testing.assert_array_equal(checked_covariance(TILTED.tolist()), TILTED)


@pytest.mark.parametrize(("ce90", "le90"), [(0.0, 1.0), (1.0, -1.0), (np.nan, 1.0), (1.0, np.inf)])
def test_figures_must_be_positive(ce90: float, le90: float) -> None:
    with pytest.raises(InputError, match="positive number of metres"):
        covariance_from_ce90_le90(ce90, le90)
