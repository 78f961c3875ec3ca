# SPDX-License-Identifier: Apache-2.0
"""The nouns that stages exchange: frozen, made of numpy arrays, free of paths.

Frames: `sfm` (arbitrary), `level` (sfm rotated so that z is up), `enu` (metres at the site), see `geo.frame`.
Pixels: u right, v down, the centre of the first pixel at (0.5, 0.5).
"""

from skymoor.types.arrays import Array, Array32, Image, Mask, Progress, no_progress
from skymoor.types.photos import Calibration, Camera, Component, Gravity, Photos
from skymoor.types.rasters import DepthMap, Raster, Reference, Render, View, Warp
from skymoor.types.registrations import Criterion, HeightStatus, HeightVerdict, Matches2D, Matches3D, Registration

__all__ = [
    "Array",
    "Array32",
    "Calibration",
    "Camera",
    "Component",
    "Criterion",
    "DepthMap",
    "Gravity",
    "HeightStatus",
    "HeightVerdict",
    "Image",
    "Mask",
    "Matches2D",
    "Matches3D",
    "Photos",
    "Progress",
    "Raster",
    "Reference",
    "Registration",
    "Render",
    "View",
    "Warp",
    "no_progress",
]
