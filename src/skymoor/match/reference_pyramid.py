# SPDX-License-Identifier: Apache-2.0
"""The reference as searches need it: its features, and its channels and spectra at each size, all or about a place."""

from __future__ import annotations

from functools import cached_property

from skymoor.match.channels import ChannelOptions, Channels, crop_channels, make_channels
from skymoor.match.correlate import Target
from skymoor.match.features import Features, features_of
from skymoor.match.pyramid import Pyramid
from skymoor.types import Raster

LARGE_PX = 2_000_000  # of a reduced reference, of which only one size is kept, and only parts are refined in


class ReferencePyramid:
    """A reference with its channels and spectra, computed once per size and channel options."""

    def __init__(self, raster: Raster, features: Features | None = None) -> None:
        self.raster = raster
        self.pyramid = Pyramid(raster)
        self._features = features
        self._targets: dict[tuple[float, ChannelOptions], Target] = {}

    @cached_property
    def features(self) -> Features:
        """Its local features."""
        return features_of(self.raster) if self._features is None else self._features

    def at(self, ratio: float, options: ChannelOptions) -> Target:
        """The reference reduced by `ratio`, at most 1."""
        if (ratio, options) not in self._targets:
            # Of a large reference, the spectra of one size are hundreds of megabytes.
            if ratio**2 * self.raster.mask.size > LARGE_PX:
                self._targets.clear()
            self._targets[ratio, options] = Target(make_channels(self.pyramid.at(ratio), options))
        return self._targets[ratio, options]


class Part:
    """Channels of the reference about a place, whose outer corner is at (left, top) of the reduced reference."""

    def __init__(self, channels: Channels, left: float, top: float) -> None:
        self._channels, self.left, self.top = channels, left, top
        self._last: tuple[tuple[int, int, int], Target] | None = None

    def window(self, u0: int, v0: int, side: int) -> Target:
        """A square of it; the last one is kept with its spectra, for turns are tried one after another in it."""
        if self._last is None or self._last[0] != (u0, v0, side):
            self._last = (u0, v0, side), Target(crop_channels(self._channels, u0, v0, side))
        return self._last[1]
