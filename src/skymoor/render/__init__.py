# SPDX-License-Identifier: Apache-2.0
"""What is rendered of a model."""

from skymoor.render.views import RenderOptions, nadir_view, oblique_views, tiles

__all__ = ["RenderOptions", "nadir_view", "oblique_views", "tiles"]
