# SPDX-License-Identifier: Apache-2.0
"""Models that can be rendered."""

from skymoor.model.blend import BlendOptions
from skymoor.model.mesh import MeshBuilder, MeshModel
from skymoor.model.nerf import NerfBuilder
from skymoor.model.protocol import SceneBuilder, SceneModel

__all__ = ["BlendOptions", "MeshBuilder", "MeshModel", "NerfBuilder", "SceneBuilder", "SceneModel"]
