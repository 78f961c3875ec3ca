# SPDX-License-Identifier: Apache-2.0
"""Models that other programs made, read as they are: `read_model` tells the kind by content."""

from skymoor.models.given import Cloud, GivenModel, Mesh, Part, Plan, Surface
from skymoor.models.read import read_model

__all__ = ["Cloud", "GivenModel", "Mesh", "Part", "Plan", "Surface", "read_model"]
