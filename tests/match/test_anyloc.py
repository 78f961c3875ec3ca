# SPDX-License-Identifier: Apache-2.0
"""VLAD on features that are known exactly, and AnyLoc on a real but tiny DINOv2 with random weights."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

import skymoor.match._anyloc
from skymoor.engines.vlad import unit, vlad, vocabulary
from skymoor.errors import BackendUnavailable, InputError, TooFewMatches
from skymoor.match import AnyLocRetriever
from skymoor.match.retrieve import UNLIKE
from skymoor.types import Array32, Raster
from support import hub
from support.pictures import noise_picture


@pytest.fixture(autouse=True)
def forget_networks() -> Iterator[None]:
    yield
    skymoor.match._anyloc._network.cache_clear()


def words(rng: np.random.Generator, clusters: int = 6, dimension: int = 16) -> Array32:
    return unit(rng.normal(size=(clusters, dimension)).astype(np.float32))


def around(centres: Array32, count: int, sigma: float, rng: np.random.Generator) -> Array32:
    """So many descriptions of each word, in random order."""
    rows = np.repeat(centres, count, axis=0)
    return (rows + rng.normal(scale=sigma, size=rows.shape)).astype(np.float32)[rng.permutation(len(rows))]


class TestVocabulary:
    def test_finds_the_words(self, rng: np.random.Generator) -> None:
        truth, sigma, count = words(rng), 0.05, 400
        found = vocabulary(around(truth, count, sigma, rng), 6, rng=rng)
        error = np.linalg.norm(found[:, None] - truth, axis=2).min(axis=0)
        expected = sigma * 4 / np.sqrt(count)  # of a mean in 16 dimensions
        assert 0.5 * expected < error.mean() < 1.5 * expected

    def test_same_seed_same_words(self, rng: np.random.Generator) -> None:
        features = around(words(rng), 50, 0.3, rng)
        one, other = (vocabulary(features, 6, rng=np.random.default_rng(3)) for _ in range(2))
        np.testing.assert_array_equal(one, other)

    def test_fewer_different_descriptions_than_words(self) -> None:
        """A blank picture has one description many times."""
        same = np.tile(np.eye(2, 8, dtype=np.float32), (50, 1))
        found = vocabulary(same, 5, rng=np.random.default_rng(0))
        assert len(found) == 2 and np.abs(np.sort(found, axis=0) - np.sort(np.eye(2, 8), axis=0)).max() < 1e-6
        with pytest.raises(TooFewMatches, match="3 local descriptors are too few for a vocabulary of 5 words"):
            vocabulary(same[:3], 5, rng=np.random.default_rng(0))


class TestVlad:
    def test_by_hand(self) -> None:
        """One word gets two descriptions, one gets one, one gets none."""
        centres = np.array([[0, 0], [10, 0], [0, 10]], np.float32)
        features = np.array([[1, 0], [2, 4], [10, -2]], np.float32)
        expected = np.array([3 / 5, 4 / 5, 0, -1, 0, 0]) / np.sqrt(2)
        np.testing.assert_allclose(vlad(features, centres), expected, atol=1e-6)

    def test_order_and_repetition_do_not_count(self, rng: np.random.Generator) -> None:
        centres = words(rng)
        features = around(centres, 20, 0.2, rng)
        again = np.concatenate([features, features])[rng.permutation(2 * len(features))]
        np.testing.assert_allclose(vlad(again, centres), vlad(features, centres), atol=1e-5)

    def test_one_place_is_more_like_itself(self, rng: np.random.Generator) -> None:
        """Places differ from the words in their own ways; two looks at one of them have their own noise."""
        centres = words(rng)
        places = [centres + rng.normal(scale=0.1, size=centres.shape).astype(np.float32) for _ in range(12)]
        one, other = (np.stack([vlad(around(p, 30, 0.1, rng), centres) for p in places]) for _ in range(2))
        likeness = one @ other.T
        own, foreign = np.diag(likeness), likeness[~np.eye(12, dtype=bool)]
        assert own.min() > foreign.max()
        # The residual of a place is 0.1 per axis, its noise in a mean of 30 is 0.1 / sqrt(30), in both looks.
        assert np.mean(own) == pytest.approx(1 / (1 + 1 / 30), abs=0.03)
        assert abs(foreign.mean()) < 0.05

    def test_nothing_is_like_nothing(self) -> None:
        assert not vlad(np.zeros((0, 4), np.float32), np.eye(4, dtype=np.float32)).any()


@pytest.fixture
def dinov2(tmp_path: Path) -> Path:
    return hub.dinov2(tmp_path / "dinov2")


def picture(seed: int) -> Raster:
    rng = np.random.default_rng(seed)
    rgb = np.roll(noise_picture((140, 168)), rng.integers(0, 140, 2), axis=(0, 1))[:, :, rng.permutation(3)]
    return Raster(np.ascontiguousarray(rgb), np.ones(rgb.shape[:2], bool))


class TestAnyLoc:
    def test_the_values_of_the_layer(self, dinov2: Path) -> None:
        """What the hook sees is what the layer computes from its own input; dark patches are left out."""
        import transformers

        network = transformers.AutoModel.from_pretrained(dinov2).eval()
        look = skymoor.match._anyloc._network(dinov2, "cpu", 2)
        raster = picture(0)
        raster.mask[:, :70] = False
        features = look(raster, 168)
        rgb = torch.from_numpy(raster.rgb).permute(2, 0, 1)[None] / 255
        mean, std = (torch.tensor(x).view(1, 3, 1, 1) for x in ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]))
        with torch.inference_mode():
            states = network((rgb - mean) / std, output_hidden_states=True).hidden_states
            layer = network.encoder.layer[2]
            (value,) = (m for name, m in layer.named_modules() if name.endswith(("v_proj", "value")))
            expected = value(layer.norm1(states[2]))[0, 1:].view(10, 12, 32)[:, 5:].reshape(-1, 32).numpy()
        assert features.shape == (70, 32)
        np.testing.assert_allclose(features, unit(expected), atol=1e-5)

    def test_a_tile_is_found_again(self, dinov2: Path, rng: np.random.Generator) -> None:
        retriever = AnyLocRetriever(str(dinov2), device="cpu", clusters=4, vocabulary_tiles=5)
        tiles = [picture(k) for k in range(8)]
        noisy = [
            np.clip(tile.rgb + rng.normal(scale=8, size=tile.rgb.shape), 0, 255).astype(np.uint8) for tile in tiles
        ]
        tiles[3] = Raster(tiles[3].rgb, np.zeros((140, 168), bool))
        likeness = retriever([Raster(rgb, np.ones((140, 168), bool)) for rgb in noisy], tiles)
        assert likeness.shape == (8, 8) and (likeness[:, 3] == UNLIKE).all() and np.abs(likeness).max() <= 1 + 1e-6
        for k in set(range(8)) - {3}:
            assert np.argmax(likeness[k]) == k and likeness[k, k] < 1 - 1e-6

    def test_nothing_to_compare(self, dinov2: Path) -> None:
        retriever = AnyLocRetriever(str(dinov2), device="cpu")
        assert retriever([], [picture(0)]).shape == (0, 1) and retriever([picture(0)], []).shape == (1, 0)
        blank = Raster(picture(0).rgb, np.zeros((140, 168), bool))
        assert (retriever([picture(0)], [blank, blank]) == UNLIKE).all()

    def test_more_layers_than_there_are(self, dinov2: Path) -> None:
        with pytest.raises(InputError, match="has 4 layers; layer = 4 must be between -1 and 3"):
            AnyLocRetriever(str(dinov2), device="cpu", layer=4)([picture(0)], [picture(1)])


def test_options_that_make_no_sense() -> None:
    with pytest.raises(InputError, match="clusters = 0"):
        AnyLocRetriever(clusters=0)


def test_the_small_one_is_fetched_under_its_own_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path))
    with pytest.raises(BackendUnavailable, match="skymoor weights fetch dinov2-small"):
        AnyLocRetriever(size="small")([picture(0)], [picture(1)])
