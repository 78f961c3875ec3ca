# SPDX-License-Identifier: Apache-2.0
"""Registration of ground photos by matches with tiles of airborne renders (paper, section 3.4).

For learned dense matchers, which match walls between ground photos and airborne renders. `exhaustive` matches all
pairs, as the paper; `cascade` gives the same result with a fraction of the pairs.
"""

from skymoor.ground.tiles.cascade import CascadeOptions, cascade
from skymoor.ground.tiles.evidence import ConsensusOptions
from skymoor.ground.tiles.exhaustive import exhaustive
from skymoor.ground.tiles.images import TileImageOptions, tile_px_for

__all__ = ["CascadeOptions", "ConsensusOptions", "TileImageOptions", "cascade", "exhaustive", "tile_px_for"]
