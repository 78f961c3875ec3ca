# SPDX-License-Identifier: Apache-2.0
"""A finished run in three dimensions: what there is to see, and a viewer that shows it in a browser."""

from skymoor.results.viewer.scene import Cameras, Frustum, parts_of
from skymoor.results.viewer.server import Page, view_run
from skymoor.results.viewer.surfaces import Layer, draped

__all__ = ["Cameras", "Frustum", "Layer", "Page", "draped", "parts_of", "view_run"]
