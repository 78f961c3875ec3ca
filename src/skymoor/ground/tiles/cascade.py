# SPDX-License-Identifier: Apache-2.0
"""The result of the exhaustive search for a fraction of its pairs.

One right pair of photo and tile predicts which tiles show what all other photos show. So pairs are matched in the order
of their similarity until one of them yields a hypothesis, and hypotheses are tested on other photos: a right one is
confirmed at once, a wrong one is not.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from skymoor.engines.options import FIXED
from skymoor.geometry import Similarity
from skymoor.ground.tiles.evidence import ConsensusOptions, Evidence, PairEvidence, Pool, evidence_of
from skymoor.ground.tiles.images import airborne_tiles, ground_photo, samples_of, shown_shares
from skymoor.match import DenseMatcher, Retriever
from skymoor.match.retrieve import ChannelRetriever
from skymoor.types import Array, DepthMap, Progress, Registration, Render, no_progress

SAMPLES = 150


@dataclass(frozen=True)
class CascadeOptions:
    """Limits of the search and of its tests.

    Attributes:
        min_coverage: tiles that show less than this share are left out.
        max_share: of all pairs, after which the search ends without a result.
        budget_s: seconds after which it does so.
        tested: hypotheses that are tested on other photos after each round.
        probes: photos on which a hypothesis is tested first.
        seen_tiles: tiles per photo that are matched once a hypothesis is confirmed.
        min_shown, reach_m: a tile overlaps a photo if it shows this share of the photo's points, this near.
        same_m: hypotheses that map the model's points this close to each other are one.
        decisive_margin: see `ConsensusOptions.min_margin`; with this one the search stops.
        consensus: how matches become a similarity. Its scales are around eye height, which is approximately the unit
            of a levelled component.
        retriever: ranks the tiles by similarity with a photo.
        upright_weight: weight of the share of walls in a tile against that similarity, both in standard deviations:
            ground photos show walls. The order is drawn with these odds.
    """

    min_coverage: float = field(default=0.2, metadata=FIXED)
    max_share: float = 0.25
    budget_s: float = float("inf")
    tested: int = field(default=3, metadata=FIXED)
    probes: int = field(default=3, metadata=FIXED)
    seen_tiles: int = field(default=3, metadata=FIXED)
    min_shown: float = field(default=0.05, metadata=FIXED)
    reach_m: float = field(default=1.5, metadata=FIXED)
    same_m: float = field(default=2.5, metadata=FIXED)
    decisive_margin: float = field(default=2.0, metadata=FIXED)
    consensus: ConsensusOptions = field(
        default_factory=lambda: ConsensusOptions(min_scale=0.6, max_scale=2.6), metadata=FIXED
    )
    retriever: Retriever = field(default_factory=ChannelRetriever, metadata=FIXED)
    upright_weight: float = field(default=1.0, metadata=FIXED)


def cascade(
    maps_level: Sequence[DepthMap],
    renders: Sequence[Render],
    matcher: DenseMatcher,
    options: CascadeOptions | None = None,
    *,
    enu_from_render: Similarity | None = None,
    rng: np.random.Generator,
    progress: Progress = no_progress,
    clock: Callable[[], float] = time.monotonic,
) -> Registration:
    """Registration of a ground component by matching its photos with few tiles of the airborne renders.

    Arguments, result and errors are those of `exhaustive`. The diagnostics also hold "out_of_time", 1 where the
    budget ended the search, and "tiles_left_out". `clock` counts seconds; no pair is started after `budget_s`.
    """
    options = options or CascadeOptions()
    start_s = clock()
    photos = tuple(ground_photo(depth_map, options.consensus.pictures) for depth_map in maps_level)
    airborne = airborne_tiles(renders, options.consensus.pictures, enu_from_render=enu_from_render)
    evidence = evidence_of(photos, airborne, matcher, options.consensus, rng)
    usable = np.array([tile.coverage >= options.min_coverage for tile in airborne.tiles])
    total = len(photos) * len(usable)
    spending = _Spending(int(np.ceil(options.max_share * total)), options.budget_s, start_s, clock)
    found = _Search(evidence, options, usable, spending, progress).run()
    counts = {
        "pairs": spending.spent,
        "pairs_in_all": total,
        "tiles": len(usable),
        "tiles_left_out": int(np.count_nonzero(~usable)),
        "photos": len(photos),
        "out_of_time": int(spending.out_of_time()),
    }
    return replace(found, diagnostics={**found.diagnostics, **{key: float(n) for key, n in counts.items()}})


@dataclass
class _Spending:
    """Pairs and seconds that are left."""

    limit: int
    budget_s: float
    start_s: float
    clock: Callable[[], float]
    spent: int = 0

    def out_of_time(self) -> bool:
        return self.clock() - self.start_s >= self.budget_s

    def over(self) -> bool:
        return self.spent >= self.limit or self.out_of_time()


@dataclass(eq=False)
class _Tested:
    """A hypothesis, and the number of matches of each photo (n,) that agree with it.

    It is tested again when as many photos agree as `needed_supporters`.
    """

    enu_from_level: Similarity
    inliers: NDArray[np.intp]
    needed_supporters: int = 1
    confirmed: bool = False


class _Search:
    """The state of one search."""

    def __init__(
        self,
        evidence: Evidence,
        options: CascadeOptions,
        usable: NDArray[np.bool_],
        spending: _Spending,
        progress: Progress,
    ) -> None:
        self._evidence, self._options, self._usable = evidence, options, usable
        self._spending, self._progress = spending, progress
        self._pairs: list[PairEvidence] = []
        self._done = np.tile(~usable, (len(evidence.photos), 1))
        self._hypotheses: list[_Tested] = []
        self._samples = samples_of(evidence.photos, SAMPLES, evidence.rng)

    def run(self) -> Registration:
        """Rounds of one new tile per photo and of tests, until the result is decisive or nothing is left."""
        photos = [k for k, points in enumerate(self._samples) if np.isfinite(points).all()]
        order = np.argsort(-self._likely(), axis=1, kind="stable")
        while not self._spending.over() and not self._done[photos].all():
            for photo in photos:
                left = order[photo][~self._done[photo, order[photo]]]
                self._try(photo, left[:1])
            self._add(self._consensus(Pool.of(self._pairs)))
            confirmed = [self._test(hypothesis) for hypothesis in self._promising()]
            if any(confirmed) and self._decisive():
                break
        return self._conclude(with_icp=True)

    def _likely(self) -> Array:
        """Log odds, up to a constant, that tiles (n photos, n tiles) overlap photos, before anything is matched."""
        tiles = self._evidence.airborne.tiles
        photos = [photo.raster for photo in self._evidence.photos]
        similarity = self._options.retriever(photos, [tile.raster for tile in tiles])
        upright = np.array([[tile.upright for tile in tiles]])
        likely = _standardised(similarity) + self._options.upright_weight * _standardised(upright)
        # Randomly, so that photos differ: if all began with the same wall, and it were a wrong one, all would be wrong.
        return np.asarray(likely + self._evidence.rng.gumbel(size=likely.shape))

    def _try(self, photo: int, tiles: NDArray[np.intp]) -> None:
        """Match a photo with those of the tiles that it has not been matched with, within the budget."""
        for tile in tiles[~self._done[photo, tiles]]:
            if self._spending.over():
                return
            (pair,) = self._evidence.match(photo, [int(tile)])
            self._pairs.append(pair)
            self._done[photo, tile] = True
            self._spending.spent += 1
            self._progress(self._spending.spent, self._spending.limit)
            for one in self._hypotheses:
                one.inliers += self._inliers([pair], one.enu_from_level)
            self._add(self._evidence.hypothesis(pair.matches, level=True))

    def _add(self, enu_from_level: Similarity | None) -> None:
        """Keep a hypothesis, unless it is known."""
        if enu_from_level is None:
            return
        if all(
            self._evidence.apart_m(enu_from_level, p.enu_from_level) >= self._options.same_m for p in self._hypotheses
        ):
            self._hypotheses.append(_Tested(enu_from_level, self._inliers(self._pairs, enu_from_level)))

    def _promising(self) -> list[_Tested]:
        """Hypotheses that were not tested yet, or with more agreeing photos since; the best few."""
        waiting = [p for p in self._hypotheses if not p.confirmed and self._supporters(p) >= p.needed_supporters]
        waiting.sort(key=lambda p: (self._supporters(p), int(p.inliers.sum())), reverse=True)
        return waiting[: self._options.tested]

    def _test(self, tested: _Tested) -> bool:
        """Match other photos with the tiles that they should show; if one agrees, match all. Whether one did."""
        expected = self._expected(tested.enu_from_level)
        agree = tested.inliers >= self._options.consensus.min_photo_inliers
        others = [int(photo) for photo in np.argsort(-expected.max(axis=1), kind="stable") if not agree[photo]]
        for photo in others[: self._options.probes]:
            self._try(photo, _best(expected[photo], 1))
        self._refine(tested)
        tested.needed_supporters = self._supporters(tested) + 1
        if self._supporters(tested) < 2:
            return False
        tested.confirmed = True
        for photo, row in enumerate(self._expected(tested.enu_from_level)):
            self._try(photo, _best(row, self._options.seen_tiles))
        self._refine(tested)
        return True

    def _refine(self, tested: _Tested) -> None:
        """Fit a hypothesis to all matches near it: one pair alone determines its rotation poorly."""
        pool = Pool.of(self._pairs)
        refined = self._consensus(pool.take(pool.gaps_m(tested.enu_from_level) <= self._options.same_m))
        if refined is None:
            return
        inliers = self._inliers(self._pairs, refined)
        if inliers.sum() >= tested.inliers.sum():
            tested.enu_from_level, tested.inliers = refined, inliers

    def _consensus(self, pool: Pool) -> Similarity | None:
        """A hypothesis from matches of several pairs: two matches and gravity determine one."""
        return self._evidence.hypothesis(pool.matches, level=True)

    def _expected(self, enu_from_level: Similarity) -> Array:
        """Expected overlap of tiles and photos (n photos, n tiles) under a hypothesis; 0 if too small.

        A render with the viewing direction of the photo is preferred: it shows the same sides of things.
        """
        airborne, options = self._evidence.airborne, self._options
        shares = shown_shares(airborne, enu_from_level.apply(self._samples), options.reach_m)
        views = np.array([photo.forward_level for photo in self._evidence.photos]) @ enu_from_level.rotation.T
        forward = np.array([airborne.forward_enu(tile.render) for tile in airborne.tiles])
        parallel = (1 + views[:, :2] @ forward[:, :2].T) / 2
        return np.where((shares >= options.min_shown) & self._usable, shares * parallel, 0.0)

    def _inliers(self, pairs: Sequence[PairEvidence], enu_from_level: Similarity) -> NDArray[np.intp]:
        """Matches of each photo (n,) that agree with a hypothesis."""
        pool = Pool.of(pairs)
        near = pool.gaps_m(enu_from_level) <= self._options.consensus.inlier_m
        return np.bincount(pool.photo[near], minlength=len(self._evidence.photos))

    def _supporters(self, tested: _Tested) -> int:
        return int(np.count_nonzero(tested.inliers >= self._options.consensus.min_photo_inliers))

    def _decisive(self) -> bool:
        found = self._conclude(with_icp=False)
        d = found.diagnostics
        return found.registered and d["score"] >= self._options.decisive_margin * d["second_score"]

    def _conclude(self, *, with_icp: bool) -> Registration:
        hypotheses = [one.enu_from_level for one in self._hypotheses]
        return self._evidence.conclude(self._pairs, hypotheses, with_icp=with_icp)


def _best(row: Array, count: int) -> NDArray[np.intp]:
    """The tiles with the largest expected overlap, without those that have none."""
    order = np.argsort(-row, kind="stable")[:count]
    return order[row[order] > 0]


def _standardised(rows: Array) -> Array:
    """Rows without their mean, in standard deviations."""
    return np.asarray((rows - rows.mean(axis=1, keepdims=True)) / (rows.std(axis=1, keepdims=True) + 1e-12))
