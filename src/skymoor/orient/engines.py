# SPDX-License-Identifier: Apache-2.0
"""The choice of who says what is ground."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from skymoor.engines.choice import Choice
from skymoor.orient._oneformer import OneFormerLabeler
from skymoor.orient._semantic import SemanticLabeler
from skymoor.orient.protocol import GroundLabeler
from skymoor.types import Image, Mask


@dataclass(frozen=True)
class LabelOptions(Choice):
    """Which network labels the ground in photos.

    Attributes:
        kind: "none" leaves it to geometry; "oneformer" is the paper's, "semantic" a lighter one.
        oneformer, semantic: how each is set up.
    """

    kind: Literal["none", "oneformer", "semantic"] = "none"
    oneformer: OneFormerLabeler = field(default_factory=OneFormerLabeler)
    semantic: SemanticLabeler = field(default_factory=SemanticLabeler)

    def __call__(self, image: Image) -> Mask:
        """Labels by the chosen one; see `GroundLabeler`."""
        ground: Mask = self.engine(image)
        return ground


_: type[GroundLabeler] = LabelOptions
