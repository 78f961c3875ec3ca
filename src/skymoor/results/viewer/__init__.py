# SPDX-License-Identifier: Apache-2.0
"""A finished run in three dimensions: what there is to see, and a viewer that shows it in a browser."""

from skymoor.results.viewer.scene import Frustum, Layer, Scene, draped, scene_of
from skymoor.results.viewer.server import view_run

__all__ = ["Frustum", "Layer", "Scene", "draped", "scene_of", "view_run"]
