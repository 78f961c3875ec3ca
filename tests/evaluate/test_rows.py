# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.errors import InputError
from skymoor.evaluate import Estimate, EvaluationRow, Truth, evaluate
from skymoor.geo import EnuFrame, covariance_from_ce90_le90

Array = NDArray[np.float64]

FRAME = EnuFrame(46.5, 7.5, 600.0)
COVARIANCE = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.2], [0.0, 0.2, 4.0]])
CENTRE = np.array([10.0, -20.0, 5.0])


def truth_positions(n: int) -> Array:
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-200, 200, (n, 2)), rng.uniform(80, 120, n)])


def truths(xyz_enu: Array) -> list[Truth]:
    return [Truth(f"air/{k}.jpg", *lla) for k, lla in enumerate(FRAME.lla_from_enu(xyz_enu).tolist())]


def estimates(xyz_enu: Array, component: int = 0) -> list[Estimate]:
    return [
        Estimate(f"air/{k}.jpg", "airborne", component, True, *lla, ce90=2.0, le90=3.0)
        for k, lla in enumerate(FRAME.lla_from_enu(xyz_enu).tolist())
    ]


def one_row(found: Array, truth: Array) -> EvaluationRow:
    centres = {("airborne", 0): CENTRE}
    (row,) = evaluate(estimates(found), truths(truth), FRAME, COVARIANCE, centres)
    return row


def test_injected_bias_and_noise_come_back() -> None:
    truth = truth_positions(400)
    bias, sigma = np.array([3.0, -4.0, 12.0]), 0.5
    row = one_row(truth + bias + np.random.default_rng(2).normal(0, sigma, truth.shape), truth)
    # The mean length of a 3D normal error is sigma * sqrt(8 / pi), its median 1.538 sigma.
    assert 12.9 < row.mean_absolute_m < 13.1
    assert 12.9 < row.median_absolute_m < 13.1
    assert 4.9 < row.mean_horizontal_m < 5.1
    assert 11.9 < row.mean_vertical_m < 12.1
    assert 0.95 < row.mean_relative_m / (sigma * np.sqrt(8 / np.pi)) < 1.05
    assert 0.93 < row.median_relative_m / (1.538 * sigma) < 1.07
    assert 0.93 < row.rmse_procrustes_m / (sigma * np.sqrt(3)) < 1.05
    expected = np.sqrt(bias @ np.linalg.solve(COVARIANCE, bias))
    assert row.mahalanobis_of_mean == pytest.approx(expected, rel=0.03)
    assert row.mean_mahalanobis == pytest.approx(expected, rel=0.03)
    assert row.mean_mahalanobis > row.mahalanobis_of_mean
    assert (row.status, row.n_cameras, row.n_truth) == ("REGISTERED", 400, 400)
    assert (row.predicted_ce90_m, row.predicted_le90_m) == (2.0, 3.0)


def test_pure_bias_is_exact() -> None:
    truth, bias = truth_positions(5), np.array([1.0, 2.0, 2.0])
    row = one_row(truth + bias, truth)
    assert row.mean_absolute_m == pytest.approx(3.0, abs=1e-6)
    assert row.mean_relative_m == pytest.approx(0.0, abs=1e-6)
    assert row.rmse_procrustes_m == pytest.approx(0.0, abs=1e-6)
    assert row.standoff_m == pytest.approx(np.linalg.norm(truth + bias - CENTRE, axis=1).mean(), abs=1e-6)


def test_mahalanobis_uses_the_whole_vector_and_covariance() -> None:
    truth = truth_positions(4)
    signs = np.array([1.0, -1.0, 1.0, -1.0])[:, None]
    row = one_row(truth + signs * [3.0, 0.0, 0.0], truth)
    assert row.mahalanobis_of_mean == pytest.approx(0.0, abs=1e-6)
    assert row.mean_mahalanobis == pytest.approx(3.0 * np.sqrt(np.linalg.inv(COVARIANCE)[0, 0]), abs=1e-6)


def test_ce90_holds_90_percent() -> None:
    covariance = covariance_from_ce90_le90(2.1, 3.8)
    truth = truth_positions(1)
    on_the_circle = truth + [2.1, 0.0, 0.0]
    (row,) = evaluate(estimates(on_the_circle), truths(truth), FRAME, covariance, {})
    assert row.mahalanobis_of_mean == pytest.approx(np.sqrt(-2 * np.log(0.1)), abs=1e-6)
    assert row.standoff_m is None


def test_wrong_scale_and_turn_are_absolute_not_procrustes_errors() -> None:
    truth = truth_positions(30)
    turn = Rotation.from_euler("z", 2.0, degrees=True).as_matrix()
    row = one_row(1.01 * truth @ turn.T, truth)
    assert 4.0 < row.mean_absolute_m < 8.0
    assert row.mean_relative_m > 3.0
    assert row.rmse_procrustes_m == pytest.approx(0.0, abs=1e-6)


def test_two_cameras_and_a_line_have_no_procrustes_error() -> None:
    for n in (2, 6):
        line = np.arange(n)[:, None] * np.array([10.0, 5.0, 0.0])
        row = one_row(line + [1.0, 0.0, 0.0], line)
        assert row.rmse_procrustes_m is None
        assert row.mean_absolute_m == pytest.approx(1.0, abs=1e-6)


def test_components_are_rows_and_refused_ones_have_no_numbers() -> None:
    truth = truth_positions(8)
    first = estimates(truth + [1.0, 0, 0])[:4]
    second = [Estimate(f"air/{k}.jpg", "airborne", 1, False) for k in (4, 5)]
    third = [replace(row, set="ground") for row in estimates(truth + [0, 2.0, 0])[6:]]
    loose = [Estimate("air/loose.jpg", "airborne", None, False)]
    rows = evaluate([*first, *second, *loose, *third], truths(truth), FRAME, COVARIANCE, {})
    assert [(row.set, row.component, row.status) for row in rows] == [
        ("airborne", 0, "REGISTERED"),
        ("airborne", 1, "NOT_REGISTERED"),
        ("ground", 0, "REGISTERED"),
    ]
    assert rows[0].mean_absolute_m == pytest.approx(1.0, abs=1e-6)
    assert rows[1] == EvaluationRow("airborne", 1, "NOT_REGISTERED", n_cameras=2, n_truth=2)
    assert rows[2].mean_absolute_m == pytest.approx(2.0, abs=1e-6)


def test_a_camera_without_a_position_does_not_invalidate_its_component() -> None:
    truth = truth_positions(6)
    found = estimates(truth + [1.0, 0, 0])
    (row,) = evaluate([*found[:5], Estimate("air/5.jpg", "airborne", 0, False)], truths(truth), FRAME, COVARIANCE, {})
    assert (row.status, row.n_cameras) == ("REGISTERED", 5)
    assert row.mean_absolute_m == pytest.approx(1.0, abs=1e-6)


def test_without_heights_the_plan_is_evaluated_alone() -> None:
    truth, bias = truth_positions(30), np.array([1.2, -0.9, 40.0])
    found = [replace(one, height=None, le90=None) for one in estimates(truth + bias)]
    (row,) = evaluate(found, truths(truth), FRAME, COVARIANCE, {})
    assert row.status == "REGISTERED" and row.mean_horizontal_m == pytest.approx(1.5, abs=0.01)
    assert (row.bias_east_m, row.bias_north_m) == pytest.approx((1.2, -0.9), abs=0.01)
    assert row.share_within_ce90 == 1.0 and row.predicted_ce90_m == 2.0
    for value in (row.mean_absolute_m, row.mean_vertical_m, row.bias_up_m, row.share_within_le90, row.mean_mahalanobis):
        assert value is None


def test_a_truth_of_part_of_the_photos_is_evaluated_where_it_is_known() -> None:
    truth = truth_positions(9)
    wrong = truth + [0.0, 3.0, 0.0]
    wrong[6:] += 50.0  # of which nothing is known
    (row,) = evaluate(estimates(wrong), truths(truth)[:6], FRAME, COVARIANCE, {})
    (alone,) = evaluate(estimates(wrong)[:6], truths(truth)[:6], FRAME, COVARIANCE, {})
    assert (row.n_cameras, row.n_truth, row.n_without_truth) == (9, 6, 3)
    assert row == replace(alone, n_cameras=9, n_without_truth=3)
    assert row.mean_absolute_m == pytest.approx(3.0, abs=1e-6)
    in_plan = [replace(one, height=None, le90=None) for one in estimates(wrong)]
    (row,) = evaluate(in_plan, truths(truth)[:6], FRAME, COVARIANCE, {})
    assert (row.n_cameras, row.n_without_truth) == (9, 3) and row.mean_horizontal_m == pytest.approx(3.0, abs=1e-6)


def test_a_component_without_truth_beside_one_with_has_a_row_without_measures() -> None:
    truth = truth_positions(6)
    other = [replace(one, component=1) for one in estimates(truth)[3:]]
    first, second = evaluate([*estimates(truth)[:3], *other], truths(truth)[:3], FRAME, COVARIANCE, {})
    assert first.mean_absolute_m is not None and first.n_without_truth == 0
    assert second == EvaluationRow("airborne", 1, "REGISTERED", n_cameras=3, n_truth=0, n_without_truth=3)


def test_mistakes_in_the_lists() -> None:
    truth = truth_positions(6)
    found, known = estimates(truth), truths(truth)
    with pytest.raises(InputError, match=r"none of the 6 registered images: air/0\.jpg.*, \.\.\."):
        evaluate(found, [], FRAME, COVARIANCE, {})
    with pytest.raises(InputError, match=r"name them relative to the site's folder"):
        evaluate(found, [replace(one, image=one.image[4:]) for one in known], FRAME, COVARIANCE, {})
    with pytest.raises(InputError, match=r"air/0\.jpg more than once"):
        evaluate(found, [*known, known[0]], FRAME, COVARIANCE, {})
    with pytest.raises(InputError, match=r"air/2\.jpg more than once"):
        evaluate([*found, found[2]], known, FRAME, COVARIANCE, {})
    with pytest.raises(InputError, match=r"air/0\.jpg counts as registered but has no position"):
        evaluate([replace(found[0], lat=None)], known, FRAME, COVARIANCE, {})
