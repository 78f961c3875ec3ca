# SPDX-License-Identifier: Apache-2.0
"""Depth maps to a mesh that can be rendered."""

from skymoor.model.mesh.mesh import MeshBuilder, MeshModel

__all__ = ["MeshBuilder", "MeshModel"]
