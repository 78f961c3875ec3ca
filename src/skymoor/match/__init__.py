# SPDX-License-Identifier: Apache-2.0
"""Matching of images of the same area from different sensors: search, dense matching, retrieval."""

from skymoor.match._aliked import AlikedMatcher
from skymoor.match._anyloc import AnyLocRetriever
from skymoor.match._loftr import LoftrMatcher
from skymoor.match._roma import RomaMatcher, TinyRomaMatcher
from skymoor.match._romav2 import RomaV2Matcher
from skymoor.match._xfeat import XfeatMatcher
from skymoor.match.align import match_hypothesis, warp_raster
from skymoor.match.cyclic import CyclicOptions, cyclic_matches
from skymoor.match.decoys import DecoyOptions, decoy_scores
from skymoor.match.hypothesis import ImageHypothesis
from skymoor.match.protocol import DenseMatcher, PointMatcher, Retriever
from skymoor.match.retrieve import ChannelRetriever
from skymoor.match.search import SearchOptions, search_hypotheses
from skymoor.match.structural import StructuralMatcher

__all__ = [
    "AlikedMatcher",
    "AnyLocRetriever",
    "ChannelRetriever",
    "CyclicOptions",
    "DecoyOptions",
    "DenseMatcher",
    "ImageHypothesis",
    "LoftrMatcher",
    "PointMatcher",
    "Retriever",
    "RomaMatcher",
    "RomaV2Matcher",
    "SearchOptions",
    "StructuralMatcher",
    "TinyRomaMatcher",
    "XfeatMatcher",
    "cyclic_matches",
    "decoy_scores",
    "match_hypothesis",
    "search_hypotheses",
    "warp_raster",
]
