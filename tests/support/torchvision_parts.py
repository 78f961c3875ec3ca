# SPDX-License-Identifier: Apache-2.0
"""What romatch takes from torchvision, which has no build for CPUs on PyPI; and romatch on that.

The parts do what torchvision's own do: with pictures of PIL, a size of two numbers and no trained weights.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch
from PIL import Image
from torch import Tensor, nn

VGG19 = (64, 64, 0, 128, 128, 0, *4 * (256,), 0, *4 * (512,), 0, *4 * (512,), 0)  # channels; 0 halves the picture


class InterpolationMode(Enum):
    """By the numbers of PIL."""

    NEAREST = Image.Resampling.NEAREST
    BILINEAR = Image.Resampling.BILINEAR
    BICUBIC = Image.Resampling.BICUBIC


class Resize:
    """Stretches a picture to (h, w)."""

    def __init__(self, size: tuple[int, int], interpolation: InterpolationMode = InterpolationMode.BILINEAR) -> None:
        self.size, self.interpolation = size, interpolation

    def __call__(self, picture: Image.Image) -> Image.Image:
        return picture.resize(self.size[::-1], self.interpolation.value)


class Normalize:
    """Takes a mean from each channel and divides by a spread."""

    def __init__(self, mean: list[float], std: list[float]) -> None:
        self.mean, self.std = (torch.tensor(x).view(-1, 1, 1) for x in (mean, std))

    def __call__(self, picture: Tensor) -> Tensor:
        return (picture - self.mean) / self.std


def vgg19_bn(weights: None = None) -> Any:
    """The layers of Simonyan and Zisserman's network with normalised batches, as many as see a picture."""
    layers: list[nn.Module] = []
    before = 3
    for channels in VGG19:
        if channels:
            layers += [nn.Conv2d(before, channels, 3, padding=1), nn.BatchNorm2d(channels), nn.ReLU(inplace=True)]
            before = channels
        else:
            layers.append(nn.MaxPool2d(2, 2))
    return SimpleNamespace(features=nn.Sequential(*layers))


@contextmanager
def romatch_library(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The library romatch, on torchvision where that is, else on the parts. It is forgotten afterwards."""
    if find_spec("torchvision") is None:
        for name, module in _modules().items():
            monkeypatch.setitem(sys.modules, name, module)
    import loguru
    import romatch

    loguru.logger.disable("romatch")
    yield romatch
    for name in [name for name in sys.modules if name.partition(".")[0] == "romatch"]:
        del sys.modules[name]


def draw_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Layers begin as zeros: drawing numbers that are overwritten from a file takes most of a large network's time."""
    for draw in ("uniform_", "normal_"):
        monkeypatch.setattr(Tensor, draw, lambda tensor, *_, **__: tensor.zero_())


def _modules() -> dict[str, ModuleType]:
    """By their names."""
    functional = _module("transforms.functional", InterpolationMode=InterpolationMode)
    # ToTensor is for files and pictures that the engines do not give.
    transforms = _module("transforms", functional=functional, Resize=Resize, Normalize=Normalize, ToTensor=None)
    models = _module("models", vgg19_bn=vgg19_bn)
    whole = _module("", transforms=transforms, models=models)
    return {module.__name__: module for module in (whole, transforms, functional, models)}


def _module(name: str, **content: Any) -> ModuleType:
    module = ModuleType("torchvision" + "." * bool(name) + name)
    module.__spec__ = ModuleSpec(module.__name__, None)
    module.__dict__.update(content)
    return module
