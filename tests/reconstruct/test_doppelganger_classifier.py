# SPDX-License-Identifier: Apache-2.0
"""The ten layers of pairs that are known exactly, and the real architecture with weights that are not trained."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.reconstruct import DoppelgangerClassifier, ViewGraph
from skymoor.reconstruct._doppelgangers import _reduced, pair_layers
from skymoor.reconstruct._doppelgangers_network import Classifier, load_classifier
from skymoor.types import Photos
from support.pictures import noise_picture

SIZE = (160, 120)
PICTURE = noise_picture((240, 320))[40:160, 60:220]
SHIFT = np.array([30, -12])  # from pixels of the first photo to those of the second
FIRST = np.roll(PICTURE, -SHIFT[::-1], axis=(0, 1))


@pytest.fixture(autouse=True)
def forget_networks() -> Iterator[None]:
    yield
    load_classifier.cache_clear()


def matches_of(rng: np.random.Generator, count: int = 60, *, wrong: int = 0) -> NDArray[np.float64]:
    px = rng.uniform([5, 20], [120, 110], (count, 2))
    there = px + SHIFT
    there[:wrong] = rng.uniform([0, 0], SIZE, (wrong, 2))
    return np.hstack([px, there])


class TestLayers:
    def test_the_first_photo_lies_on_the_second(self, rng: np.random.Generator) -> None:
        """With a fifth of wrong matches, photo and dots are warped to within a pixel."""
        layers = pair_layers(_reduced(FIRST, 160), _reduced(PICTURE, 160), matches_of(rng, wrong=12), 160)
        assert layers.shape == (10, 160, 160) and layers.dtype == np.float32
        np.testing.assert_allclose(layers[4:7, :120, :160], np.moveaxis(PICTURE[..., ::-1], -1, 0) / 255, atol=1e-6)
        assert not layers[4:7, 120:].any()
        warped = layers[7:, 5:100, 35:155]
        assert np.abs(warped - layers[4:7, 5:100, 35:155]).mean() < 0.04 < 0.1 < np.abs(warped - warped[:, ::-1]).mean()
        np.testing.assert_array_equal(layers[0], layers[1])
        np.testing.assert_array_equal(layers[2], layers[3])
        rows, columns = np.nonzero(layers[2])
        near = [
            layers[0][max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2].any() for r, c in zip(rows, columns, strict=True)
        ]
        assert 0.75 < np.mean(near) < 0.95

    def test_photos_of_other_sizes(self, rng: np.random.Generator) -> None:
        """Matches are in pixels of the whole photos."""
        matches = matches_of(rng)
        large = np.repeat(np.repeat(FIRST, 3, axis=0), 3, axis=1)
        whole = np.hstack([3 * matches[:, :2], matches[:, 2:]])
        layers = pair_layers(_reduced(large, 160), _reduced(PICTURE, 160), whole, 160)
        plain = pair_layers(_reduced(FIRST, 160), _reduced(PICTURE, 160), matches, 160)
        np.testing.assert_allclose(layers, plain, atol=0.02)

    def test_reduced_to_multiples_of_eight(self) -> None:
        small, ratio = _reduced(np.zeros((1000, 1501, 3), np.uint8), 1024)
        assert small.shape == (680, 1024, 3)
        np.testing.assert_allclose(ratio, [1024 / 1501, 0.68])

    def test_without_a_similarity_nothing_is_laid(self) -> None:
        layers = pair_layers(_reduced(FIRST, 160), _reduced(PICTURE, 160), np.array([[10.5, 20.5, 90.5, 7.5]]), 160)
        np.testing.assert_allclose(layers[7:, :120], np.moveaxis(FIRST[..., ::-1], -1, 0) / 255, atol=1e-6)
        assert np.argwhere(layers[0]).tolist() == [[20, 10]] and np.argwhere(layers[2]).tolist() == [[7, 90]]


@pytest.fixture
def graph(rng: np.random.Generator) -> ViewGraph:
    pictures = {"a": FIRST, "b": PICTURE, "c": np.ascontiguousarray(PICTURE[::-1])}
    photos = Photos(tuple(pictures), (SIZE,) * 3, pictures.__getitem__)
    return ViewGraph(photos, ((0, 1), (1, 2), (2, 0)), tuple(matches_of(rng) for _ in range(3)), ())


def saved(path: Path, bias: tuple[float, float] | None = None, *, prefix: str = "module.") -> Path:
    """The network as its authors save it; with a bias it gives the same for every pair."""
    torch.manual_seed(0)
    tensors = Classifier().state_dict()
    if bias:
        tensors["fc.weight"].zero_()
        tensors["fc.bias"] = torch.tensor(bias)
    content = {"dec": {prefix + name: tensor for name, tensor in tensors.items()}, "epoch": 10, "optim": {"lr": 1e-3}}
    torch.save(content, path)
    return path


class TestClassifier:
    def test_the_architecture(self) -> None:
        """11.165 million numbers that are learned; a sixteenth of the side before they are averaged."""
        network = Classifier().eval()
        assert sum(parameter.numel() for parameter in network.parameters()) == pytest.approx(11.165e6, abs=500)
        names = set(network.state_dict())
        assert {"conv1.weight", "layer1.0.downsample.1.running_var", "layer3.1.bn2.bias", "fc.bias"} <= names
        assert not any(name.startswith("layer2.1.downsample") for name in names)
        assert network.layer3(network.layer2(network.layer1(torch.zeros(1, 128, 32, 32)))).shape == (1, 512, 4, 4)

    def test_pairs_above_the_threshold_are_kept(self, graph: ViewGraph, tmp_path: Path) -> None:
        """A bias of 2 for the same place is a probability of 0.88."""
        path = str(saved(tmp_path / "same.pt", (0.0, 2.0)))
        np.testing.assert_allclose(
            DoppelgangerClassifier(path, "cpu", side_px=160).probabilities(graph), 1 / (1 + np.exp(-2)), rtol=1e-5
        )
        assert DoppelgangerClassifier(path, "cpu", side_px=160)(graph) == [0, 1, 2]
        assert DoppelgangerClassifier(path, "cpu", 0.9, side_px=160)(graph) == []

    def test_names_with_and_without_the_word_of_several_gpus(self, graph: ViewGraph, tmp_path: Path) -> None:
        """And each pair has a probability of its own."""
        both = []
        for prefix in ("module.", ""):
            path = saved(tmp_path / f"{prefix}x.pt", prefix=prefix)
            both.append(DoppelgangerClassifier(str(path), "cpu", side_px=160).probabilities(graph))
        np.testing.assert_array_equal(*both)
        assert len(np.unique(both[0])) == 3
        middle = float(np.sort(both[0])[1])
        kept = DoppelgangerClassifier(str(path), "cpu", middle, side_px=160)(graph)
        assert kept == [k for k, p in enumerate(both[0]) if p >= middle] and len(kept) == 2

    def test_options_that_make_no_sense(self) -> None:
        with pytest.raises(InputError, match=r"min_probability = 1\.2"):
            DoppelgangerClassifier(min_probability=1.2)


def test_nothing_to_classify(tmp_path: Path) -> None:
    empty = ViewGraph(Photos((), (), lambda _: PICTURE), (), (), ())
    assert DoppelgangerClassifier(str(saved(tmp_path / "x.pt")), "cpu")(empty) == []
