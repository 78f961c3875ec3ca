# SPDX-License-Identifier: Apache-2.0
"""Ground labels of segmentation networks: names, sizes, and the real architectures with random weights."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

import skymoor.orient._oneformer
import skymoor.orient._semantic
from skymoor.errors import InputError
from skymoor.orient import OneFormerLabeler, SemanticLabeler
from skymoor.orient._classes import ground_ids, ground_of, small
from support import hub
from support.pictures import noise_picture

PHOTO = noise_picture((90, 120))


@pytest.fixture(autouse=True)
def forget_networks() -> Iterator[None]:
    yield
    skymoor.orient._oneformer._network.cache_clear()
    skymoor.orient._semantic._network.cache_clear()


class TestNames:
    def test_whole_words_of_three_data_sets(self) -> None:
        ground = ["road, route", "earth, ground", "swimming pool, swimming bath", "water-other", "Parking", "sea"]
        other = ["waterfall, falls", "pool table", "wall-stone", "grandstand", "street sign", "streetlight", "bridge"]
        mixed = [name for pair in zip(other, ground, strict=False) for name in pair]
        assert [mixed[k] for k in ground_ids(dict(enumerate(mixed)), Path("m"))] == ground

    def test_none_is_ground(self) -> None:
        with pytest.raises(InputError, match=r"model: none of its classes \(LABEL_0, LABEL_1, .*\) is ground"):
            ground_ids({0: "LABEL_0", 1: "LABEL_1"}, Path("model"))

    def test_labels_of_a_reduced_photo(self) -> None:
        """A border at a known column comes back to within half a pixel of the reduced photo."""
        labels = np.zeros((30, 40), np.int64)
        labels[:, 13:] = 7
        ground = ground_of(labels, [3, 7], np.zeros((300, 400, 3), np.uint8))
        assert ground.shape == (300, 400) and (ground == (np.arange(400) >= 130)).all()

    def test_photos_are_reduced_and_never_enlarged(self) -> None:
        assert small(PHOTO, 60).shape == (45, 60, 3)
        assert small(PHOTO, 500) is PHOTO


@pytest.fixture
def upernet(tmp_path: Path) -> Path:
    return hub.upernet(tmp_path / "upernet")


@pytest.fixture
def oneformer(tmp_path: Path) -> Path:
    return hub.oneformer(tmp_path / "oneformer")


def set_bias(folder: Path, tensor: str, bias: list[float]) -> None:
    """Make one class win everywhere."""
    from safetensors.torch import load_file, save_file

    tensors = load_file(folder / "model.safetensors")
    (name,) = (name for name in tensors if name.endswith(tensor + ".bias"))
    tensors[name] = torch.tensor(bias)
    tensors[name[:-4] + "weight"].zero_()
    save_file(tensors, folder / "model.safetensors", {"format": "pt"})


class TestSemantic:
    def test_joins_the_ground_classes(self, upernet: Path, capfd: pytest.CaptureFixture[str]) -> None:
        ground = SemanticLabeler(str(upernet), "cpu")(PHOTO)
        assert ground.shape == (90, 120) and ground.dtype == bool
        processor, network = skymoor.orient._semantic._network(upernet, "cpu")
        given = processor(images=PHOTO, return_tensors="pt")
        with torch.inference_mode():
            scores = torch.nn.functional.interpolate(network(**given).logits, (90, 120), mode="bilinear")
        expected = np.isin(scores[0].argmax(dim=0).numpy(), [1, 3])
        assert 0.02 < expected.mean() < 0.98
        assert (ground == expected).mean() > 0.99
        assert capfd.readouterr() == ("", "")

    def test_the_winner_decides(self, upernet: Path) -> None:
        for k in range(4):
            set_bias(upernet, "decode_head.classifier", [5.0 * (j == k) for j in range(4)])
            skymoor.orient._semantic._network.cache_clear()
            assert SemanticLabeler(str(upernet), "cpu")(PHOTO).mean() == (k in (1, 3))

    def test_weights_as_a_checkpoint_of_pytorch(self, upernet: Path) -> None:
        """As OneFormer and UperNet are published: read, but not if there is code in it."""
        from safetensors.torch import load_file

        before = SemanticLabeler(str(upernet), "cpu")(PHOTO)
        skymoor.orient._semantic._network.cache_clear()
        tensors = load_file(upernet / "model.safetensors")
        (upernet / "model.safetensors").unlink()
        torch.save(tensors, upernet / "pytorch_model.bin")
        np.testing.assert_array_equal(SemanticLabeler(str(upernet), "cpu")(PHOTO), before)
        skymoor.orient._semantic._network.cache_clear()
        torch.save(tensors | {"hook": Path("x")}, upernet / "pytorch_model.bin")
        with pytest.raises(InputError, match="upernet: cannot be read"):
            SemanticLabeler(str(upernet), "cpu")(PHOTO)


class TestOneFormer:
    def test_the_winner_decides(self, oneformer: Path, capfd: pytest.CaptureFixture[str]) -> None:
        for k in range(4):
            set_bias(oneformer, "decoder.class_embed", [9.0 * (j == k) for j in range(5)])
            skymoor.orient._oneformer._network.cache_clear()
            ground = OneFormerLabeler(str(oneformer), "cpu")(PHOTO)
            assert ground.shape == (90, 120) and ground.mean() == (k in (1, 3))
        assert capfd.readouterr() == ("", "")

    def test_the_list_of_classes(self, oneformer: Path) -> None:
        """Beside the folder will do; without it nothing asks the hub."""
        before = OneFormerLabeler(str(oneformer), "cpu")(PHOTO)
        skymoor.orient._oneformer._network.cache_clear()
        (oneformer / "ade20k_panoptic.json").rename(oneformer.parent / "ade20k_panoptic.json")
        np.testing.assert_array_equal(OneFormerLabeler(str(oneformer), "cpu")(PHOTO), before)
        skymoor.orient._oneformer._network.cache_clear()
        (oneformer.parent / "ade20k_panoptic.json").unlink()
        with pytest.raises(
            InputError, match=r"list of classes ade20k_panoptic\.json is missing; put it into the folder"
        ):
            OneFormerLabeler(str(oneformer), "cpu")(PHOTO)
