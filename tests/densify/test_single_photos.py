# SPDX-License-Identifier: Apache-2.0
"""Depth of single photos: signs, sizes and lenses, with the real architectures and random weights."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import skymoor.densify._depth_anything
import skymoor.densify._marigold
from hub import assert_refuses_bad_folders, save
from pictures import noise_picture
from skymoor.densify import DepthAnythingDepth, MarigoldDepth, MetricDepthNetwork
from skymoor.errors import BackendUnavailable, InputError

PHOTO = noise_picture((90, 120))
SIZE = {"height": 56, "width": 56}
DPT = {"image_processor_type": "DPTImageProcessor", "size": SIZE, "keep_aspect_ratio": True, "ensure_multiple_of": 14}


@pytest.fixture(autouse=True)
def forget_networks() -> Iterator[None]:
    yield
    skymoor.densify._depth_anything._network.cache_clear()
    skymoor.densify._marigold._pipeline.cache_clear()


def depth_anything(folder: Path, kind: str) -> Path:
    """A real one, tiny. Its last layer gives the metric one depths between 0 and 80."""
    import transformers

    torch.manual_seed(0)
    backbone = transformers.Dinov2Config(
        hidden_size=16, num_hidden_layers=4, num_attention_heads=2, image_size=56, patch_size=14, mlp_ratio=2,
        out_features=["stage1", "stage2", "stage3", "stage4"], reshape_hidden_states=False,
    )  # fmt: skip
    config = transformers.DepthAnythingConfig(
        backbone_config=backbone, reassemble_hidden_size=16, neck_hidden_sizes=[8, 8, 16, 16], fusion_hidden_size=8,
        head_hidden_size=8, depth_estimation_type=kind, max_depth=80 if kind == "metric" else 1,
    )  # fmt: skip
    network = transformers.DepthAnythingForDepthEstimation(config)
    # Random weights of the usual size give the same depth everywhere.
    for parameter in network.parameters():
        if parameter.ndim == 4:
            torch.nn.init.normal_(parameter, std=0.3)
    torch.nn.init.normal_(network.head.conv3.weight, std=1e-3)
    torch.nn.init.constant_(network.head.conv3.bias, 0.5)
    return save(network, folder, DPT)


def direct(folder: Path) -> Any:
    """What the network itself says about the photo, at its own size."""
    processor, network = skymoor.densify._depth_anything._network(
        folder, "cpu", metric="metric" in (folder / "config.json").read_text()
    )
    given = processor(images=PHOTO, return_tensors="pt")
    with torch.inference_mode():
        depth = network(**given).predicted_depth
    return torch.nn.functional.interpolate(depth[None], PHOTO.shape[:2], mode="bilinear")[0, 0].numpy(), given


class TestRelative:
    def test_larger_is_farther(self, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
        """The network says inverse depth: its order is turned round."""
        folder = depth_anything(tmp_path / "relative", "relative")
        capfd.readouterr()
        depth = DepthAnythingDepth(str(folder), "cpu")(PHOTO)
        assert capfd.readouterr() == ("", "")
        assert depth.shape == (90, 120) and depth.dtype == np.float32
        assert depth.min() == -1 and depth.max() == 0
        inverse, _ = direct(folder)
        assert inverse.std() > 1e-3
        assert np.corrcoef(depth.ravel(), inverse.ravel())[0, 1] < -0.999

    def test_bad_folders(self, tmp_path: Path) -> None:
        good = depth_anything(tmp_path / "relative", "relative")

        def call(weights: str) -> object:
            return DepthAnythingDepth(weights, "cpu")(PHOTO)

        assert_refuses_bad_folders(call, good, tmp_path / "bad", lost="head.conv3")
        with pytest.raises(InputError, match="its depths are metric; relative depths are wanted"):
            call(str(depth_anything(tmp_path / "metric", "metric")))


class TestMetric:
    def test_metres_and_lenses(self, tmp_path: Path) -> None:
        folder = depth_anything(tmp_path / "metric", "metric")
        expected, given = direct(folder)
        assert 0 < expected.min() < expected.max() < 80 and expected.std() > 0.1
        plain = MetricDepthNetwork(str(folder), "cpu", canonical_focal_px=0, max_m=80)(PHOTO, 500.0)
        assert plain.shape == (90, 120)
        np.testing.assert_allclose(plain, expected, rtol=1e-3)
        # A lens of 500 px at 90 rows is one of 500 * 56 / 90 px in the network's input.
        ratio = given["pixel_values"].shape[-2] / 90
        wide, tele = (MetricDepthNetwork(str(folder), "cpu", max_m=80)(PHOTO, focal) for focal in (500.0, 1500.0))
        np.testing.assert_allclose(wide, plain * 500 * ratio / 1000, rtol=1e-4)
        np.testing.assert_allclose(tele, 3 * wide, rtol=1e-4)

    def test_what_is_too_far_is_unknown(self, tmp_path: Path) -> None:
        folder = depth_anything(tmp_path / "metric", "metric")
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
        folder = save(transformers.ZoeDepthForDepthEstimation(config), tmp_path / "zoe", processor)
        depth = MetricDepthNetwork(str(folder), "cpu", canonical_focal_px=0, max_m=100)(PHOTO, 500.0)
        assert depth.shape == (90, 120) and np.isfinite(depth).all() and 0 < depth.min() <= depth.max() <= 80

    def test_relative_weights_are_no_metres(self, tmp_path: Path) -> None:
        folder = depth_anything(tmp_path / "relative", "relative")
        with pytest.raises(InputError, match="its depths are relative; metres are wanted here"):
            MetricDepthNetwork(str(folder), "cpu")(PHOTO, 500.0)


@pytest.fixture
def marigold(tmp_path: Path) -> Path:
    """The real pipeline with tiny parts, as the hub publishes it."""
    import diffusers
    import transformers

    torch.manual_seed(0)
    unet = diffusers.UNet2DConditionModel(
        block_out_channels=(16, 16), layers_per_block=1, sample_size=8, in_channels=8, out_channels=4,
        down_block_types=("DownBlock2D", "CrossAttnDownBlock2D"), up_block_types=("CrossAttnUpBlock2D", "UpBlock2D"),
        cross_attention_dim=16, attention_head_dim=8, norm_num_groups=8,
    )  # fmt: skip
    vae = diffusers.AutoencoderKL(
        block_out_channels=(8, 8), norm_num_groups=4,
        down_block_types=("DownEncoderBlock2D",) * 2, up_block_types=("UpDecoderBlock2D",) * 2,
    )  # fmt: skip
    scheduler = diffusers.DDIMScheduler(
        prediction_type="v_prediction", timestep_spacing="trailing", beta_schedule="scaled_linear", clip_sample=False
    )
    words = transformers.CLIPTextConfig(
        hidden_size=16,
        intermediate_size=16,
        num_hidden_layers=1,
        num_attention_heads=2,
        vocab_size=300,
        bos_token_id=188,
        eos_token_id=189,
    )
    letters = [chr(k) for k in range(33, 127)]
    tokens = [*letters, *(letter + "</w>" for letter in letters), "<|startoftext|>", "<|endoftext|>"]
    (tmp_path / "vocab.json").write_text(json.dumps({token: k for k, token in enumerate(tokens)}))
    (tmp_path / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = transformers.CLIPTokenizer(
        str(tmp_path / "vocab.json"), str(tmp_path / "merges.txt"), model_max_length=77
    )
    pipeline = diffusers.MarigoldDepthPipeline(
        unet, vae, scheduler, transformers.CLIPTextModel(words), tokenizer, prediction_type="depth",
        scale_invariant=True, shift_invariant=True, default_denoising_steps=1, default_processing_resolution=64,
    )  # fmt: skip
    pipeline.save_pretrained(tmp_path / "marigold")
    return tmp_path / "marigold"


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

    def test_what_it_says_is_what_is_returned(self, marigold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Marigold says depth, not its inverse: the decoder's answer comes through as it is."""
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
            ("unet", "conv_out.weight"),
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


def test_options_that_make_no_sense() -> None:
    with pytest.raises(InputError, match="ensemble = 0"):
        MarigoldDepth(ensemble=0)


def test_library_or_weights_are_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = {
        "depth-anything-small": lambda: DepthAnythingDepth()(PHOTO),
        "metric-depth-small": lambda: MetricDepthNetwork()(PHOTO, 500.0),
        "marigold": lambda: MarigoldDepth()(PHOTO),
    }
    monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path))
    for name in ("transformers", "diffusers"):
        monkeypatch.setitem(sys.modules, name, sys)
    for name, call in calls.items():
        with pytest.raises(BackendUnavailable, match=f"skymoor weights fetch {name}"):
            call()
    monkeypatch.setitem(sys.modules, "transformers", None)
    for call in calls.values():
        with pytest.raises(BackendUnavailable, match=r'pip install "skymoor\[depth\]"'):
            call()
