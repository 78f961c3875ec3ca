# SPDX-License-Identifier: Apache-2.0
"""Ground photos onto the airborne model by matching them with tiles of its renders (paper, section 3.4).

For learned dense matchers, which find a photo's wall in a picture from the air. `exhaustive` matches all with all, as
the paper does; `cascade` comes to the same answer with a fraction of the pairs.
"""

from skymoor.ground.tiles.cascade import CascadeOptions, cascade
from skymoor.ground.tiles.evidence import ConsensusOptions
from skymoor.ground.tiles.exhaustive import exhaustive
from skymoor.ground.tiles.images import TileImageOptions, tile_px_for

__all__ = ["CascadeOptions", "ConsensusOptions", "TileImageOptions", "cascade", "exhaustive", "tile_px_for"]
