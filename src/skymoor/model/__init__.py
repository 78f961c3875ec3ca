# SPDX-License-Identifier: Apache-2.0
"""Models that can be rendered."""

from skymoor.model.mesh import BlendOptions, MeshBuilder, MeshModel
from skymoor.model.protocol import SceneBuilder, SceneModel

__all__ = ["BlendOptions", "MeshBuilder", "MeshModel", "SceneBuilder", "SceneModel"]
