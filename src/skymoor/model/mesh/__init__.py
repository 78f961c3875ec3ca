# SPDX-License-Identifier: Apache-2.0
"""Mesh model, built from depth maps."""

from skymoor.model.mesh.mesh import MeshBuilder, MeshModel

__all__ = ["MeshBuilder", "MeshModel"]
