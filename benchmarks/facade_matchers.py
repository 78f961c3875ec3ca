# SPDX-License-Identifier: Apache-2.0
"""Which matcher tells the right place of a ground component by its walls: key points that agree there, and elsewhere.

    OMP_NUM_THREADS=1 python benchmarks/facade_matchers.py RUN... --weights DIR... [--wrong 4]

Runs are finished runs of skymoor whose registered ground components are known to be right. The right hypothesis of a
component is the registered one, the wrong ones are the most likely of its others, more than 5 m away from it and from
each other. For each matcher of image_peers.py whose weights are in the folders of --weights (by name), and for the
dense matches of the search itself: places that agree, at the right hypotheses and at the wrong ones.
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from image_peers import PEERS, Peer

from skymoor.ground.walls import AirborneWalls, GroundOptions, RefinedHypothesis, WallHypotheses
from skymoor.ground.walls.facade_pairs import FacadePair, pair_facades
from skymoor.ground.walls.key_points import agreeing_cells
from skymoor.ground.walls.pool import apart
from skymoor.match import PointMatcher
from skymoor.store import read_stage
from skymoor.types import Array, DepthMap, Raster

ELSEWHERE_M = 5.0


@dataclass
class Counts:
    """Of one matcher, over all hypotheses."""

    right: list[int] = field(default_factory=list)
    wrong: list[int] = field(default_factory=list)
    seconds: float = 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--weights", type=Path, nargs="*", default=[])
    parser.add_argument("--wrong", type=int, default=4, help="hypotheses of each component")
    options = parser.parse_args()
    matchers = {peer.name: matcher for peer in PEERS if (matcher := point_matcher(peer, options.weights)) is not None}
    counts = {name: Counts() for name in ["dense matches of the search", *matchers]}
    for run in options.runs:
        walls = read_stage(run, "walls")
        for name in sorted({re.split(r"\.search", path.name)[0] for path in (run / "stages").glob("ground*.search-*")}):
            measure(
                read_stage(run, f"{name}.depths"), walls, read_stage(run, f"{name}.search"), matchers, counts, options
            )
    show(counts)


def point_matcher(peer: Peer, folders: Sequence[Path]) -> PointMatcher | None:
    """The peer as a matcher of upright pictures; None where a file of it is in none of the folders."""
    files = [next((file for folder in folders for file in folder.rglob(name)), None) for name in peer.weights]
    if None in files:
        return None
    describe, match = peer.make(*files)

    def matched(a: Raster, b: Raster) -> tuple[Array, Array]:
        in_a, in_b = describe(a), describe(b)
        if min(len(in_a.px), len(in_b.px)) < 8:
            return np.zeros((0, 2)), np.zeros((0, 2))
        i, j = match(in_a, in_b)
        return in_a.px[i], in_b.px[j]

    return matched


def measure(
    maps: Sequence[DepthMap],
    walls: AirborneWalls,
    search: WallHypotheses,
    matchers: dict[str, PointMatcher],
    counts: dict[str, Counts],
    options: argparse.Namespace,
) -> None:
    """Add the counts of one component, if it is registered."""
    if not isinstance(search, WallHypotheses) or not search.decide().registered:
        return
    best, *others = search.candidates
    places = [best]
    for one in others:
        far = all(apart(one.enu_from_level, kept.enu_from_level, search.probes) > ELSEWHERE_M for kept in places)
        if far and len(places) <= options.wrong:
            places.append(one)
    for place in places:
        side = "right" if place is best else "wrong"
        getattr(counts["dense matches of the search"], side).append(place.cells)
        pairs = pairs_at(place, maps, walls)
        for name, matcher in matchers.items():
            started = time.process_time()
            getattr(counts[name], side).append(agreeing_cells(pairs, matcher))
            counts[name].seconds += time.process_time() - started


def pairs_at(place: RefinedHypothesis, maps: Sequence[DepthMap], walls: AirborneWalls) -> list[FacadePair]:
    options = GroundOptions().facade_pairs
    return pair_facades(walls.facades, walls.heights, maps, place.enu_from_level, options)


def show(counts: dict[str, Counts]) -> None:
    """Markdown."""
    print("| matcher | right: least, median | wrong: median, most | CPU s per place |\n|---|---|---|---|")
    for name, one in counts.items():
        if one.right and one.wrong:
            each = one.seconds / (len(one.right) + len(one.wrong))
            right = f"{min(one.right)}, {np.median(one.right):.0f}"
            print(f"| {name} | {right} | {np.median(one.wrong):.0f}, {max(one.wrong)} | {each:.1f} |")
    first = next(iter(counts.values()))
    print(f"\n{len(first.right)} components, {len(first.wrong)} wrong places")


if __name__ == "__main__":
    main()
