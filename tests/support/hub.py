# SPDX-License-Identifier: Apache-2.0
"""Tiny networks of real architectures with random weights, in folders as a model hub publishes them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch

NAMES = ["wall", "road, route", "sky", "grass"]
SWIN = {"embed_dim": 8, "depths": [1, 1, 1, 1], "num_heads": [1, 2, 2, 2], "window_size": 4}
STAGES = ["stage1", "stage2", "stage3", "stage4"]
SIZE = {"height": 56, "width": 56}
DPT = {"image_processor_type": "DPTImageProcessor", "size": SIZE, "keep_aspect_ratio": True, "ensure_multiple_of": 14}


def save(network: Any, folder: Path, processor: dict[str, Any] | None = None) -> Path:
    """The folder of a network and of how pictures are prepared for it."""
    network.save_pretrained(folder)
    if processor is not None:
        (folder / "preprocessor_config.json").write_text(json.dumps(processor))
    return folder


def upernet(folder: Path) -> Path:
    """A real UperNet on a tiny ConvNeXt; every class wins somewhere."""
    import transformers

    torch.manual_seed(0)
    backbone = transformers.ConvNextConfig(hidden_sizes=[4, 4, 8, 8], depths=[1, 1, 1, 1], out_features=STAGES)
    config = transformers.UperNetConfig(
        backbone_config=backbone, hidden_size=16, auxiliary_channels=8, auxiliary_in_channels=8, **_names()
    )
    network = transformers.UperNetForSemanticSegmentation(config)
    torch.nn.init.normal_(network.decode_head.classifier.weight)
    size = {"height": 64, "width": 64}
    return save(network, folder, {"image_processor_type": "SegformerImageProcessor", "size": size})


def oneformer(folder: Path) -> Path:
    """A real OneFormer on a tiny Swin, with a tokenizer of single letters."""
    import transformers

    torch.manual_seed(0)
    config = transformers.OneFormerConfig(
        backbone_config=transformers.SwinConfig(out_features=STAGES, **SWIN),
        hidden_dim=32, conv_dim=32, mask_dim=32, num_attention_heads=2, dim_feedforward=16, encoder_layers=1,
        encoder_feedforward_dim=16, decoder_layers=2, query_dec_layers=1, num_queries=5, text_encoder_width=16,
        text_encoder_num_layers=1, text_encoder_vocab_size=600, **_names(),
    )  # fmt: skip
    processor = {
        "image_processor_type": "OneFormerImageProcessor",
        "size": {"shortest_edge": 64, "longest_edge": 128},
        "class_info_file": "ade20k_panoptic.json",
        "repo_path": "shi-labs/oneformer_demo",
        "num_text": 3,
    }
    save(transformers.OneFormerForUniversalSegmentation(config), folder, processor)
    _letters(folder)
    (folder / "tokenizer_config.json").write_text(json.dumps({"tokenizer_class": "CLIPTokenizer"}))
    (folder / "ade20k_panoptic.json").write_text(
        json.dumps({str(k): {"name": name, "isthing": 0} for k, name in enumerate(NAMES)})
    )
    return folder


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


def marigold(folder: Path) -> Path:
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
        hidden_size=16, intermediate_size=16, num_hidden_layers=1, num_attention_heads=2, vocab_size=300,
        bos_token_id=188, eos_token_id=189,
    )  # fmt: skip
    tokenizer = transformers.CLIPTokenizer(*map(str, _letters(folder)), model_max_length=77)
    pipeline = diffusers.MarigoldDepthPipeline(
        unet, vae, scheduler, transformers.CLIPTextModel(words), tokenizer, prediction_type="depth",
        scale_invariant=True, shift_invariant=True, default_denoising_steps=1, default_processing_resolution=64,
    )  # fmt: skip
    pipeline.save_pretrained(folder)
    return folder


def dinov2(folder: Path) -> Path:
    """A real one of four layers."""
    import transformers

    torch.manual_seed(0)
    config = transformers.Dinov2Config(
        hidden_size=32, num_hidden_layers=4, num_attention_heads=2, image_size=70, patch_size=14, mlp_ratio=2
    )
    return save(transformers.Dinov2Model(config), folder)


def _names(count: int = 4) -> dict[str, Any]:
    return {"id2label": dict(enumerate(NAMES[:count])), "label2id": {name: k for k, name in enumerate(NAMES[:count])}}


def _letters(folder: Path) -> tuple[Path, Path]:
    """The files of a tokenizer of single letters."""
    folder.mkdir(exist_ok=True)
    letters = [chr(k) for k in range(33, 127)]
    words = [*letters, *(letter + "</w>" for letter in letters), "<|startoftext|>", "<|endoftext|>"]
    (folder / "vocab.json").write_text(json.dumps({word: k for k, word in enumerate(words)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    return folder / "vocab.json", folder / "merges.txt"
