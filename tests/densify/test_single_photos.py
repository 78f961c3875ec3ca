# SPDX-License-Identifier: Apache-2.0
"""Depth of single photos: signs, sizes and lenses, with the real architectures and random weights."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import skymoor.densify._depth_anything
import skymoor.densify._marigold
from skymoor.densify import DepthAnythingDepth, MarigoldDepth, MetricDepthNetwork
from skymoor.errors import InputError
from support import hub
from support.pictures import noise_picture

PHOTO = noise_picture((90, 120))


@pytest.fixture(autouse=True)
def forget_networks() -> Iterator[None]:
    yield
    skymoor.densify._depth_anything._network.cache_clear()
    skymoor.densify._marigold._pipeline.cache_clear()


def direct(folder: Path) -> Any:
    """Prediction of the network itself for the photo, at its own size."""
    processor, network = skymoor.densify._depth_anything._network(
        folder, "cpu", metric="metric" in (folder / "config.json").read_text()
    )
    given = processor(images=PHOTO, return_tensors="pt")
    with torch.inference_mode():
        depth = network(**given).predicted_depth
    return torch.nn.functional.interpolate(depth[None], PHOTO.shape[:2], mode="bilinear")[0, 0].numpy(), given


class TestRelative:
    def test_larger_is_farther(self, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
        """The network predicts inverse depth, whose order is reversed."""
        folder = hub.depth_anything(tmp_path / "relative", "relative")
        capfd.readouterr()
        depth = DepthAnythingDepth(str(folder), "cpu")(PHOTO)
        assert capfd.readouterr() == ("", "")
        assert depth.shape == (90, 120) and depth.dtype == np.float32
        assert depth.min() == -1 and depth.max() == 0
        inverse, _ = direct(folder)
        assert inverse.std() > 1e-3
        assert np.corrcoef(depth.ravel(), inverse.ravel())[0, 1] < -0.999


class TestMetric:
    def test_metres_and_focal_lengths(self, tmp_path: Path) -> None:
        folder = hub.depth_anything(tmp_path / "metric", "metric")
        expected, given = direct(folder)
        assert 0 < expected.min() < expected.max() < 80 and expected.std() > 0.1
        plain = MetricDepthNetwork(str(folder), "cpu", canonical_focal_px=0, max_m=80)(PHOTO, 500.0)
        assert plain.shape == (90, 120)
        np.testing.assert_allclose(plain, expected, rtol=1e-3)
        # A focal length of 500 px at 90 rows is one of 500 * 56 / 90 px in the network's input.
        ratio = given["pixel_values"].shape[-2] / 90
        wide, tele = (MetricDepthNetwork(str(folder), "cpu", max_m=80)(PHOTO, focal) for focal in (500.0, 1500.0))
        np.testing.assert_allclose(wide, plain * 500 * ratio / 1000, rtol=1e-4)
        np.testing.assert_allclose(tele, 3 * wide, rtol=1e-4)

    def test_what_is_too_far_is_unknown(self, tmp_path: Path) -> None:
        folder = hub.depth_anything(tmp_path / "metric", "metric")
        expected, _ = direct(folder)
        limit = float(np.median(expected))
        depth = MetricDepthNetwork(str(folder), "cpu", canonical_focal_px=0, max_m=limit)(PHOTO, 500.0)
        assert np.isnan(depth).mean() == pytest.approx(0.5, abs=0.02)

    def test_zoedepth(self, tmp_path: Path) -> None:
        """Another network, in metres as well, through the same door."""
        import transformers

        torch.manual_seed(0)
        backbone = transformers.BeitConfig(
            hidden_size=16, num_hidden_layers=4, num_attention_heads=2, intermediate_size=16, image_size=64,
            out_features=["stage1", "stage2", "stage3", "stage4"], reshape_hidden_states=False,
            use_relative_position_bias=True,
        )  # fmt: skip
        config = transformers.ZoeDepthConfig(
            backbone_config=backbone, neck_hidden_sizes=[8, 8, 16, 16], fusion_hidden_size=16, bottleneck_features=16,
            num_relative_features=8, bin_embedding_dim=16, num_attractors=[4, 2, 2, 1],
            bin_configurations=[{"n_bins": 8, "min_depth": 0.001, "max_depth": 80.0, "name": "kitti"}],
        )  # fmt: skip
        processor = {"image_processor_type": "ZoeDepthImageProcessor", "size": {"height": 64, "width": 64}}
        folder = hub.save(transformers.ZoeDepthForDepthEstimation(config), tmp_path / "zoe", processor)
        depth = MetricDepthNetwork(str(folder), "cpu", canonical_focal_px=0, max_m=100)(PHOTO, 500.0)
        assert depth.shape == (90, 120) and np.isfinite(depth).all() and 0 < depth.min() <= depth.max() <= 80

    def test_relative_weights_are_no_metres(self, tmp_path: Path) -> None:
        folder = hub.depth_anything(tmp_path / "relative", "relative")
        with pytest.raises(InputError, match="its depths are relative; metric depths are required here"):
            MetricDepthNetwork(str(folder), "cpu")(PHOTO, 500.0)
        folder = hub.depth_anything(tmp_path / "metric", "metric")
        with pytest.raises(InputError, match="its depths are metric; relative depths are required here"):
            DepthAnythingDepth(str(folder), "cpu")(PHOTO)


@pytest.fixture
def marigold(tmp_path: Path) -> Path:
    return hub.marigold(tmp_path / "marigold")


class TestMarigold:
    def test_depth_of_the_photos_size(self, marigold: Path, capfd: pytest.CaptureFixture[str]) -> None:
        capfd.readouterr()
        engine = MarigoldDepth(str(marigold), "cpu", side_px=64)
        depth, again = engine(PHOTO), engine(PHOTO)
        assert capfd.readouterr() == ("", "")
        assert depth.shape == (90, 120) and depth.dtype == np.float32
        assert 0 <= depth.min() < depth.max() <= 1
        np.testing.assert_array_equal(depth, again)
        assert not np.array_equal(depth, MarigoldDepth(str(marigold), "cpu", side_px=64, seed=1)(PHOTO))

    def test_the_prediction_is_returned_unchanged(self, marigold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Marigold predicts depth, not its inverse: the decoder's output is returned unchanged."""
        pipeline = skymoor.densify._marigold._pipeline(marigold, "cpu")
        ramp = torch.linspace(-1, 1, 120).expand(1, 3, 90, 120)

        def decode(latent: torch.Tensor, **_: Any) -> Any:
            height, width = latent.shape[2] * 2, latent.shape[3] * 2
            return (torch.nn.functional.interpolate(ramp, (height, width), mode="bilinear"),)

        monkeypatch.setattr(pipeline.vae, "decode", decode)
        depth = MarigoldDepth(str(marigold), "cpu", side_px=64)(PHOTO)
        assert np.corrcoef(depth.mean(axis=0), np.arange(120))[0, 1] > 0.999
        assert depth[:, 110].mean() - depth[:, 10].mean() > 0.7

    def test_bad_parts(self, marigold: Path, tmp_path: Path) -> None:
        def call(folder: Path) -> object:
            return MarigoldDepth(str(folder), "cpu", side_px=64)(PHOTO)

        for part, lost in (
            ("vae", "quant_conv.bias"),
            ("text_encoder", "final_layer_norm"),
        ):
            bad = tmp_path / part
            shutil.copytree(marigold, bad)
            (file,) = (bad / part).glob("*.safetensors")
            whole = file.read_bytes()
            file.write_bytes(whole[:-50])
            with pytest.raises(InputError, match=rf"{part}: cannot be read"):
                call(bad)
            from safetensors.torch import load, save_file

            save_file({k: v for k, v in load(whole).items() if lost not in k}, file, {"format": "pt"})
            with pytest.raises(
                InputError, match=rf"{part}: (weights of another network \(lacks|cannot be read).*{lost}"
            ):
                call(bad)
            shutil.rmtree(bad / part)
            with pytest.raises(InputError, match=rf"{part}: not the folder of a model"):
                call(bad)

    def test_another_pipeline(self, marigold: Path) -> None:
        index = marigold / "model_index.json"
        index.write_text(index.read_text().replace("MarigoldDepthPipeline", "MarigoldNormalsPipeline"))
        with pytest.raises(InputError, match="holds a MarigoldNormalsPipeline, not a MarigoldDepthPipeline"):
            MarigoldDepth(str(marigold), "cpu")(PHOTO)

    def test_code_in_the_folder_is_not_run(self, marigold: Path, tmp_path: Path) -> None:
        index = json.loads((marigold / "model_index.json").read_text())
        (marigold / "model_index.json").write_text(json.dumps(index | {"scheduler": ["own", "Own"]}))
        (marigold / "scheduler/own.py").write_text(f"import os\n\nos.mkdir({str(tmp_path / 'sprung')!r})\n")
        with pytest.raises(InputError, match=r"marigold: cannot be read \(.*\); is it the right folder"):
            MarigoldDepth(str(marigold), "cpu", side_px=64)(PHOTO)
        assert not (tmp_path / "sprung").exists()


def test_options_that_make_no_sense() -> None:
    with pytest.raises(InputError, match="ensemble = 0"):
        MarigoldDepth(ensemble=0)
