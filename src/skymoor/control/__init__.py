# SPDX-License-Identifier: Apache-2.0
"""Control and check points, known camera positions and scale bars: compared with a registration, or used to move it.

The maths knows no files: `skymoor.pipeline` reads them and hands on what is found.
"""

from skymoor.control.adjust import Adjusted, adjust, snoop
from skymoor.control.examine import ControlResult, Prior, examine
from skymoor.control.given import Control, ControlPoint, KnownPosition, Mark, Place, ScaleBar, resolved
from skymoor.control.observations import Located, Observations, PosedCameras, locate
from skymoor.control.rows import ControlRow, Totals
from skymoor.control.triangulate import triangulate

__all__ = [
    "Adjusted",
    "Control",
    "ControlPoint",
    "ControlResult",
    "ControlRow",
    "KnownPosition",
    "Located",
    "Mark",
    "Observations",
    "Place",
    "PosedCameras",
    "Prior",
    "ScaleBar",
    "Totals",
    "adjust",
    "examine",
    "locate",
    "resolved",
    "snoop",
    "triangulate",
]
