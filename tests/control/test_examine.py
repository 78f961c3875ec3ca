# SPDX-License-Identifier: Apache-2.0
"""Known errors of a registration are found again by control, and wrong control is named."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.stats

from skymoor.control import Control, Observations, PosedCameras, Prior, examine, locate, snoop, triangulate
from skymoor.control.observations import Linear
from skymoor.geometry import Similarity
from skymoor.types import Array
from support.surveyed import CENTRE, FRAME, PRIOR, SIGMAS, SIX, flown, registered, surveyed, without_places

ERROR = np.array([0.004, 0.001, -0.0012, 0.003, 0.9, -0.7, 1.8])
NONE = np.zeros(7)


def drawn(rng: np.random.Generator) -> Array:
    return rng.normal(size=7) * SIGMAS


def observed(control: Control, posed: PosedCameras) -> Observations:
    return Observations.of(locate(control, posed, CENTRE), control.bars, FRAME, CENTRE)


def test_a_point_is_where_its_rays_meet(rng: np.random.Generator) -> None:
    cameras = {camera.image: camera for camera in flown()}
    point = surveyed(SIX[:1]).points[0]
    exact = triangulate(point.marks, cameras)
    assert np.abs(exact.xyz - SIX[0]).max() < 1e-6 and exact.n_photos > 5
    lengths = []
    for _ in range(60):
        found = triangulate(surveyed(SIX[:1], rng=rng).points[0].marks, cameras)
        gap = found.xyz - SIX[0]
        lengths.append(gap @ np.linalg.solve(found.covariance, gap))
    assert 2.0 < np.mean(lengths) < 3.8  # chi-square of 3, a little less where residuals widen it


def test_one_photo_is_not_enough() -> None:
    cameras = {camera.image: camera for camera in flown()}
    marks = surveyed(SIX[:1]).points[0].marks
    assert "seen in one registered photo" in triangulate(marks[:1], cameras).reason
    far = replace(marks[0], u=marks[0].u + 80)
    wrong = triangulate([far, *marks[1:]], cameras)
    assert "contradict each other" in wrong.reason and far.image in wrong.reason and np.isnan(wrong.xyz).all()


def test_residuals_are_model_minus_survey() -> None:
    shift = np.array([0, 0, 0, 0, 0.5, -0.25, 1.0])
    result = examine(surveyed(positions=[0, 3, 6]), registered(shift), FRAME, PRIOR)
    assert result is not None and not result.used and result.adjusted is None
    assert [row.use for row in result.rows] == ["check"] * 9
    for row in result.rows:
        assert np.allclose(row.residual_m, -shift[4:], atol=1e-4)  # the model must be moved by the correction
        assert row.inside_ce90 and row.inside_le90 and row.inside_ellipsoid
    assert np.allclose(result.totals.mean_m, -shift[4:], atol=1e-4) and result.totals.n == 9


def test_control_takes_the_error_out(rng: np.random.Generator) -> None:
    result = examine(surveyed(rng=rng, use=True), registered(ERROR), FRAME, PRIOR)
    assert result is not None and result.adjusted is not None and not result.reason
    left, sigma = result.adjusted.correction[:7] - ERROR, np.sqrt(np.diag(result.adjusted.covariance)[:7])
    assert (np.abs(left) < 4 * sigma).all() and (sigma[4:] < 0.06).all() and (sigma[4:] > 0.005).all()
    before = np.array([row.residual_m for row in result.rows])
    after = np.array([row.after_m for row in result.rows])
    assert np.abs(before).max() > 1.5 and 0.001 < np.abs(after).max() < 0.5
    assert {row.use for row in result.rows} == {"control"}


def test_a_wrong_point_is_named_and_left_out(rng: np.random.Generator) -> None:
    for blunder in ([3.0, 0, 0], [0, 0, -3.0], [0.3, -0.3, 0.3]):
        control = surveyed(rng=rng, off={4: np.array(blunder)}, use=True)
        result = examine(control, registered(drawn(rng)), FRAME, PRIOR)
        assert result is not None and result.used
        assert [row.name for row in result.rows if row.use == "wrong"] == ["P4"]
        wrong = result.rows[4]
        assert wrong.test is not None and wrong.limit is not None and wrong.test > wrong.limit
        assert np.allclose(wrong.after_m, -np.array(blunder), atol=0.3)
        assert any(note.startswith("P4 contradicts the others") for note in result.notes)
        assert result.totals.n == 5


def test_two_wrong_points_of_six_are_named(rng: np.random.Generator) -> None:
    off = {1: np.array([3.0, 1.0, 0.0]), 3: np.array([2.0, 0.0, 4.0])}
    result = examine(surveyed(rng=rng, off=off, use=True), registered(drawn(rng)), FRAME, PRIOR)
    assert result is not None and [row.name for row in result.rows if row.use == "wrong"] == ["P1", "P3"]


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_points_cannot_say_which_is_wrong(n: int) -> None:
    off = {0: np.array([0.0, 20.0, 0.0])}
    result = examine(surveyed(SIX[:n], off=off, use=True), registered(NONE), FRAME, PRIOR)
    assert result is not None and not result.used and result.adjusted is None
    assert ("it takes 3 surveyed positions" if n == 1 else "contradicts itself") in result.reason
    assert not any(row.use == "wrong" for row in result.rows)
    assert any(f"{n} surveyed position" in note and "from 3 on" in note for note in result.notes)
    # Without a blunder the same points are used.
    good = examine(surveyed(SIX[:n], use=True), registered(ERROR), FRAME, PRIOR)
    assert good is not None and good.used


def test_points_that_agree_overrule_a_reference_that_is_off(rng: np.random.Generator) -> None:
    geoid = np.array([0, 0, 0, 0, 0, 0, -47.0])
    result = examine(surveyed(rng=rng, use=True), registered(geoid), FRAME, PRIOR)
    assert result is not None and result.adjusted is not None
    assert result.adjusted.correction[6] == pytest.approx(-47.0, abs=0.1)
    assert any("control and reference differ by" in note and "up -47.0" in note for note in result.notes)
    checked = examine(surveyed(rng=rng), registered(geoid), FRAME, PRIOR)
    assert checked is not None and not any(row.inside_le90 for row in checked.rows)
    assert any("check CE90, LE90 and the vertical datum of both" in note for note in checked.notes)


def test_a_scale_bar_sets_the_scale() -> None:
    control = replace(without_places(surveyed(bars=[(0, 2, 1.004)])), use=True)
    result = examine(control, registered(NONE), FRAME, PRIOR)
    assert result is not None and result.adjusted is not None
    (row,) = result.rows
    assert row.kind == "scale bar" and row.ratio == pytest.approx(1 / 1.004, abs=1e-5)
    assert row.ratio_sigma is not None and 0.002 < row.ratio_sigma < 0.0025
    bar = float(np.linalg.norm(SIX[0] - SIX[2]))
    share = 0.002**2 / (row.ratio_sigma**2)
    assert result.adjusted.correction[0] == pytest.approx(0.004 * share, rel=0.02)
    assert 0.01 / bar < np.sqrt(result.adjusted.covariance[0, 0]) < 0.002


def test_three_known_cameras_of_twenty(rng: np.random.Generator) -> None:
    control = replace(surveyed(positions=[0, 5, 10], rng=rng, use=True), points=())
    result = examine(control, registered(ERROR), FRAME, PRIOR)
    assert result is not None and result.adjusted is not None
    assert [row.kind for row in result.rows] == ["position"] * 3
    sigma = np.sqrt(np.diag(result.adjusted.covariance)[:7])
    assert (np.abs(result.adjusted.correction[:7] - ERROR) < 4 * sigma).all() and (sigma[4:] < 0.2).all()


def test_a_plan_only_point_leaves_the_height() -> None:
    control = surveyed(SIX[:4], use=True)
    flat = [replace(one, place=replace(one.place, height=float("nan"))) for one in control.points if one.place]
    result = examine(replace(control, points=tuple(flat)), registered(ERROR), FRAME, PRIOR)
    assert result is not None and result.adjusted is not None
    assert np.abs(result.adjusted.correction[4:6] - ERROR[4:6]).max() < 0.05
    assert np.sqrt(result.adjusted.covariance[6, 6]) > 0.9 * SIGMAS[6]
    assert all(row.residual_m[2] is None and row.inside_le90 is None for row in result.rows)


def test_unknown_references_and_heights_are_set_by_control(rng: np.random.Generator) -> None:
    far = np.array([0, 0, 0, 0, 30.0, -20.0, 300.0])
    unknown = Prior(PRIOR.covariance, CENTRE, reference_known=False, heights_known=False)
    result = examine(surveyed(rng=rng, use=True), registered(far), FRAME, unknown)
    assert result is not None and result.adjusted is not None and result.adjusted.disagreement_m is None
    assert np.abs(result.adjusted.correction[4:7] - far[4:]).max() < 0.3
    assert any("accuracy of the reference is unknown" in note for note in result.notes)
    assert all(row.residual_m[2] is None for row in result.rows)


def test_a_wrong_focal_length_is_no_wrong_control(rng: np.random.Generator) -> None:
    """Cameras are 2 percent too high above ground that is right: an error that the prior knows of."""
    away = np.array([camera.centre * [0, 0, 1.0] for camera in flown()])
    high = tuple(
        camera.transformed(Similarity(1.0, np.eye(3), 0.02 * gap)) for camera, gap in zip(flown(), away, strict=True)
    )
    covariance = PRIOR.covariance.copy()
    covariance[7, 7] = 0.02**2
    control = replace(surveyed(positions=[14, 15, 16, 17], rng=rng, use=True), points=())
    result = examine(control, PosedCameras(high, None, away), FRAME, Prior(covariance, CENTRE))
    assert result is not None and result.adjusted is not None and all(row.inside_le90 for row in result.rows)
    assert result.adjusted.correction[7] < 0 and np.sqrt(result.adjusted.covariance[6, 6]) > 0.3


def test_distances_have_the_distribution_that_was_predicted(rng: np.random.Generator) -> None:
    """Over many registrations, whose errors are drawn from their covariance."""
    squares, shares = [], []
    for _ in range(60):
        result = examine(surveyed(SIX[[0, 4]], rng=rng), registered(drawn(rng)), FRAME, PRIOR)
        assert result is not None
        squares += [row.distance**2 for row in result.rows if row.distance is not None]
        shares += [row.inside_ce90 for row in result.rows]
    assert scipy.stats.kstest(squares[::2], scipy.stats.chi2(3).cdf).pvalue > 0.01
    assert 0.85 < np.mean(shares) < 0.95


def test_right_points_are_seldom_called_wrong_and_blunders_of_ten_sigmas_nearly_never_right() -> None:
    rng = np.random.default_rng(11)
    base = observed(surveyed(), registered(NONE))
    linear, n = base.at(), len(base)
    root = np.linalg.cholesky(linear.design @ PRIOR.covariance @ linear.design.T + linear.errors)
    alarms, named = 0, 0
    for _ in range(1000):
        noise = root @ rng.normal(size=len(root))
        alarms += len(snoop(noisy(base, noise), PRIOR.covariance).kept) < n
    assert alarms <= 6  # 1.5 are expected
    for _ in range(60):
        noise = root @ rng.normal(size=len(root))
        k = int(rng.integers(n))
        direction = rng.normal(size=3)
        sigma = np.sqrt(np.diag(linear.errors)[linear.rows[k]])
        noise[linear.rows[k]] += 10 * sigma * direction / np.linalg.norm(direction)
        named += set(range(n)) - set(snoop(noisy(base, noise), PRIOR.covariance).kept) == {k}
    assert named >= 50


@dataclass(frozen=True, eq=False)
class Noisy(Observations):
    """Observations with other misclosures."""

    linear: Linear | None = None

    def at(self, correction: Array | None = None) -> Linear:
        assert self.linear is not None
        return self.linear


def noisy(base: Observations, noise: Array) -> Noisy:
    return Noisy(base.places, base.bars, base.ends, base.frame, base.centre, replace(base.at(), misclosure=noise))
