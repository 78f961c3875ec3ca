# SPDX-License-Identifier: Apache-2.0
"""Scene models built from depth maps, and their renders."""

from skymoor.model.blend import BlendOptions
from skymoor.model.mesh.mesh import MeshBuilder, MeshModel
from skymoor.model.nerf.builder import NerfBuilder
from skymoor.model.protocol import SceneBuilder, SceneModel
from skymoor.model.views import RenderOptions, nadir_view, oblique_views, render_nadir, render_obliques, tiles

__all__ = [
    "BlendOptions",
    "MeshBuilder",
    "MeshModel",
    "NerfBuilder",
    "RenderOptions",
    "SceneBuilder",
    "SceneModel",
    "nadir_view",
    "oblique_views",
    "render_nadir",
    "render_obliques",
    "tiles",
]
