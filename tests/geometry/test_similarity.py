# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import Similarity, umeyama, umeyama_level
from support.comparators import assert_similarity_near
from support.strategies import points, similarities

Array = NDArray[np.float64]
TRUTH = Similarity(2.5, Rotation.from_euler("zyx", [130, 20, -15], degrees=True).as_matrix(), [3.0, -40.0, 7.0])
LEVEL = Similarity(2.5, Rotation.from_euler("z", 130, degrees=True).as_matrix(), [3.0, -40.0, 7.0])
MIRROR = np.array([1.0, 1.0, -1.0])


def assert_same(a: Similarity, b: Similarity) -> None:
    size = 1.0 + float(np.abs(a.translation).max())
    assert_similarity_near(a, b, rot_deg=1e-6, trans_m=1e-9 * size, scale_ppm=1e-6)


class TestGroup:
    @given(similarities(), similarities())
    @settings(max_examples=50, deadline=None)
    def test_products_are_similarities(self, a: Similarity, b: Similarity) -> None:
        np.testing.assert_allclose((a @ b).matrix(), a.matrix() @ b.matrix(), rtol=1e-9, atol=1e-7)

    @given(similarities())
    @settings(max_examples=50, deadline=None)
    def test_identity_and_inverse(self, a: Similarity) -> None:
        one = Similarity.identity()
        assert_same(one @ a, a)
        assert_same(a @ one, a)
        assert_similarity_near(a @ a.inverse(), one, rot_deg=1e-6, trans_m=1e-9, scale_ppm=1e-6)
        assert_similarity_near(a.inverse() @ a, one, rot_deg=1e-6, trans_m=1e-7, scale_ppm=1e-6)

    @given(similarities(), similarities(), similarities())
    @settings(max_examples=50, deadline=None)
    def test_associative(self, a: Similarity, b: Similarity, c: Similarity) -> None:
        assert_same((a @ b) @ c, a @ (b @ c))

    @given(similarities(), similarities(), points())
    @settings(max_examples=50, deadline=None)
    def test_product_acts_as_one_after_the_other(self, a: Similarity, b: Similarity, xyz: Array) -> None:
        np.testing.assert_allclose((a @ b).apply(xyz), a.apply(b.apply(xyz)), rtol=1e-9, atol=1e-6)

    @given(similarities())
    @settings(max_examples=50, deadline=None)
    def test_quaternion_round_trip(self, a: Similarity) -> None:
        quaternion = a.quaternion_wxyz
        assert quaternion[0] >= 0
        assert_same(Similarity.from_quaternion_wxyz(a.scale, quaternion, a.translation), a)

    def test_apply_keeps_leading_shape(self) -> None:
        xyz = np.arange(24.0).reshape(2, 4, 3)
        np.testing.assert_allclose(TRUTH.apply(xyz)[1, 2], TRUTH.apply(xyz[1, 2]))

    def test_values_cannot_be_changed(self) -> None:
        with pytest.raises(ValueError, match="read-only"):
            TRUTH.rotation[0, 0] = 0.0

    @pytest.mark.parametrize(
        ("scale", "rotation", "translation"),
        [
            (0.0, np.eye(3), np.zeros(3)),
            (-1.0, np.eye(3), np.zeros(3)),
            (np.nan, np.eye(3), np.zeros(3)),
            (1.0, np.diag(MIRROR), np.zeros(3)),
            (1.0, 1.001 * np.eye(3), np.zeros(3)),
            (1.0, np.eye(3), np.array([0.0, np.inf, 0.0])),
        ],
    )
    def test_refuses_what_is_no_similarity(self, scale: float, rotation: Array, translation: Array) -> None:
        with pytest.raises(DegenerateGeometry):
            Similarity(scale, rotation, translation)


def cloud(rng: np.random.Generator, n: int = 40, size: tuple[float, float, float] = (10, 10, 3)) -> Array:
    return rng.normal(size=(n, 3)) * size


class TestUmeyama:
    @pytest.mark.parametrize("size", [(10, 10, 3), (10, 10, 0), (10, 0, 4), (10, 0.01, 0)])
    @pytest.mark.parametrize("offset", [(0, 0, 0), (0, 0, 5), (512_345, 5_212_345, 432)])
    def test_exact_data(self, size: tuple[float, float, float], offset: tuple[float, float, float]) -> None:
        source = cloud(np.random.default_rng(1), size=size) + offset
        fitted = umeyama(source, TRUTH.apply(source))
        np.testing.assert_allclose(fitted.apply(source), TRUTH.apply(source), atol=1e-6)
        assert fitted.scale == pytest.approx(TRUTH.scale, rel=1e-8)
        # The width of 1 cm resolves the angle about the long axis of UTM-sized data to their 1 nm rounding only.
        assert np.abs(fitted.rotation - TRUTH.rotation).max() < 1e-5

    @pytest.mark.parametrize("axis", [0, 1, 2])
    def test_half_turn(self, axis: int) -> None:
        turn = Similarity(0.4, Rotation.from_rotvec(np.pi * np.eye(3)[axis]).as_matrix(), [1.0, 2.0, 3.0])
        for size in ((10, 10, 3), (10, 10, 0)):
            source = cloud(np.random.default_rng(2), size=size)
            assert_same(umeyama(source, turn.apply(source)), turn)

    def test_target_of_utm_size(self) -> None:
        truth = Similarity(2.5, TRUTH.rotation, [512_345.0, 5_212_345.0, 432.0])
        source = cloud(np.random.default_rng(3))
        assert_similarity_near(umeyama(source, truth.apply(source)), truth, rot_deg=1e-8, trans_m=1e-8, scale_ppm=1e-3)

    def test_noise_comes_back_and_scale_is_not_biased(self) -> None:
        # Noise as large as the cloud: a symmetric scale would come out 41 % too large.
        rng = np.random.default_rng(4)
        sigma, n, trials = 2.5, 50, 300
        scales, rms = [], []
        for _ in range(trials):
            source = rng.normal(size=(n, 3))
            target = TRUTH.apply(source) + rng.normal(size=(n, 3)) * sigma
            fitted = umeyama(source, target)
            scales.append(fitted.scale)
            rms.append(np.sum((fitted.apply(source) - target) ** 2) / (3 * n - 7))
        assert 0.97 * sigma < np.sqrt(np.mean(rms)) < 1.03 * sigma
        # The rotation adapts to the noise, which adds three of its degrees of freedom to the scale: about 2 %.
        assert 0.99 < np.mean(scales) / TRUTH.scale < 1.04
        # The known spread of the estimate: sigma over the root of the summed squares of the source.
        expected = sigma / np.sqrt(3 * n)
        assert 0.85 * expected < np.std(scales) < 1.15 * expected

    def test_mirrored_data_give_the_best_rotation(self) -> None:
        source = cloud(np.random.default_rng(5), size=(10, 6, 2))
        target = source * MIRROR
        fitted = umeyama(source, target)
        assert np.linalg.det(fitted.rotation) == pytest.approx(1.0)
        assert fitted.scale > 0
        cost = np.sum((fitted.apply(source) - target) ** 2)
        for other in Rotation.random(200, random_state=0).as_matrix():
            scale = max(float(np.sum(target * (source @ other.T)) / np.sum(source**2)), 1e-3)
            translation = target.mean(axis=0) - scale * other @ source.mean(axis=0)
            assert cost < np.sum((Similarity(scale, other, translation).apply(source) - target) ** 2)

    def test_mirrored_symmetric_data_are_refused(self) -> None:
        cube = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
        with pytest.raises(DegenerateGeometry, match="mirrored"):
            umeyama(cube, cube * MIRROR)

    @pytest.mark.parametrize("offset", [(0, 0, 0), (512_345, 5_212_345, 432)])
    def test_lines_and_points_are_refused(self, offset: tuple[float, float, float]) -> None:
        line = np.linspace(-50, 50, 20)[:, None] * [0.3, 0.7, 0.1] + offset
        full = cloud(np.random.default_rng(6), n=20)
        for source, target in ((line, line * 2.0), (line, full), (full, line), (line * 0 + offset, full)):
            with pytest.raises(DegenerateGeometry):
                umeyama(source, target)

    def test_too_few_and_not_finite(self) -> None:
        xyz = cloud(np.random.default_rng(7), n=3)
        with pytest.raises(TooFewMatches):
            umeyama(xyz[:2], xyz[:2])
        with pytest.raises(TooFewMatches):
            umeyama(xyz, xyz, weights=[1, 1, 0])
        with pytest.raises(DegenerateGeometry, match="finite"):
            umeyama(xyz, xyz * [1, np.nan, 1])

    def test_weights_are_repetitions(self) -> None:
        rng = np.random.default_rng(8)
        source = cloud(rng, n=6)
        target = TRUTH.apply(source) + rng.normal(size=(6, 3))
        times = np.array([1, 3, 0, 2, 1, 2])
        repeated = umeyama(np.repeat(source, times, axis=0), np.repeat(target, times, axis=0))
        assert_same(umeyama(source, target, weights=times), repeated)

    def test_fixed_scale(self) -> None:
        source = cloud(np.random.default_rng(9))
        assert umeyama(source, TRUTH.apply(source), with_scale=False).scale == 1.0


class TestUmeyamaLevel:
    @pytest.mark.parametrize("n", [2, 3, 50])
    @pytest.mark.parametrize("offset", [(0, 0, 0), (512_345, 5_212_345, 432)])
    def test_exact_data(self, n: int, offset: tuple[float, float, float]) -> None:
        source = cloud(np.random.default_rng(10), n=n) + offset
        np.testing.assert_allclose(
            umeyama_level(source, LEVEL.apply(source)).apply(source), LEVEL.apply(source), atol=1e-6
        )

    def test_minimum_of_the_squares(self) -> None:
        rng = np.random.default_rng(11)
        source = cloud(rng)
        target = LEVEL.apply(source) + rng.normal(size=source.shape) * 3.0
        fitted = umeyama_level(source, target)
        cost = np.sum((fitted.apply(source) - target) ** 2)
        for step in (-1e-3, 1e-3):
            for change in (
                Similarity(1.0 + step, np.eye(3), np.zeros(3)),
                Similarity(1.0, Rotation.from_rotvec([0, 0, step]).as_matrix(), np.zeros(3)),
                *(Similarity(1.0, np.eye(3), step * axis) for axis in np.eye(3)),
            ):
                assert np.sum(((fitted @ change).apply(source) - target) ** 2) > cost

    def test_z_axis_stays(self) -> None:
        source = cloud(np.random.default_rng(12))
        np.testing.assert_array_equal(umeyama_level(source, TRUTH.apply(source)).rotation[2], [0, 0, 1])

    def test_degenerate(self) -> None:
        pole = np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 5.0]])
        with pytest.raises(DegenerateGeometry, match="plan"):
            umeyama_level(pole, pole)
        with pytest.raises(TooFewMatches):
            umeyama_level(pole[:1], pole[:1])
        upside_down = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 9.0]])
        with pytest.raises(DegenerateGeometry, match="heights"):
            umeyama_level(upside_down, upside_down * MIRROR)
