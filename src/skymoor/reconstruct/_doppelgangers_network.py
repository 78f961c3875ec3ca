# SPDX-License-Identifier: Apache-2.0
"""The network of the doppelganger classifier (Cai et al., ICCV 2023), under the names of its published weights."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor, nn

from skymoor.engines.weights import load_into, load_state_dict


class Classifier(nn.Module):
    """Three stages of two residual blocks on ten layers; two scores: different places, the same place."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(10, 128, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(128)
        self.layer1 = nn.Sequential(_Block(128, 128, 2), _Block(128, 128, 1))
        self.layer2 = nn.Sequential(_Block(128, 256, 2), _Block(256, 256, 1))
        self.layer3 = nn.Sequential(_Block(256, 512, 2), _Block(512, 512, 1))
        self.fc = nn.Linear(512, 2)

    def forward(self, layers: Tensor) -> Tensor:
        """Scores (n, 2) of layers (n, 10, side, side)."""
        x = torch.relu(self.bn1(self.conv1(layers)))
        x = self.layer3(self.layer2(self.layer1(x)))
        scores: Tensor = self.fc(x.mean(dim=(2, 3)))
        return scores


class _Block(nn.Module):
    """He et al., Deep residual learning, CVPR 2016: two convolutions with a shortcut."""

    def __init__(self, before: int, after: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(before, after, 3, stride=stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(after)
        self.conv2 = nn.Conv2d(after, after, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(after)
        shortcut = [nn.Conv2d(before, after, 1, stride=stride, bias=False), nn.BatchNorm2d(after)]
        self.downsample = nn.Sequential(*(shortcut if stride > 1 else []))

    def forward(self, x: Tensor) -> Tensor:
        y = self.bn2(self.conv2(torch.relu(self.bn1(self.conv1(x)))))
        return torch.relu(self.downsample(x) + y)


@lru_cache(maxsize=1)
def load_classifier(weights: Path, device: str) -> Classifier:
    """The network with its published weights; raises `InputError` where they are not those of this network."""
    network = Classifier()
    # Saved from several GPUs, which prefixes each name.
    prefixed = all(name.startswith("module.") for name in load_state_dict(weights, part="dec"))
    load_into(nn.ModuleDict({"module": network}) if prefixed else network, weights, part="dec")
    return network.to(device).eval()
