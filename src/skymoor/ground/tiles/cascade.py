# SPDX-License-Identifier: Apache-2.0
"""The answer of the exhaustive search for a fraction of its pairs.

One right pair is enough to know where all other photos look. So pairs are tried in the order of how alike they look
until one of them suggests a place; the place says which tile shows what another photo shows; and a right place is
confirmed there at once, a wrong one is not.
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
    """How pairs are saved.

    Attributes:
        min_coverage: tiles that show less than this share are left out.
        max_share: of all pairs, after which the search gives up: what is nowhere is found nowhere.
        budget_s: seconds after which it does so.
        tested: places that are tested on other photos after each round.
        probes: photos on which a place is tested first.
        seen_tiles: tiles per photo that are matched once a place is confirmed.
        min_shown, reach_m: a tile sees what a photo sees if it shows this share of the photo's points this near.
        same_m: places that put the model's points this close to each other are one.
        decisive_margin: see `ConsensusOptions.min_margin`; with this one the search stops.
        consensus: how matches become a similarity. Its scales lie round the height of a person's eyes, which is about
            the unit of a levelled component.
        retriever: says which tiles come first,
        upright_weight: together with the walls that a tile shows, for that is what ground photos show: the weight of
            their share against the likeness, both in standard deviations. The order is drawn with these odds.
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
    """Where a ground component stands, by matching its photos with few tiles of the airborne renders.

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
class _Place:
    """A hypothesis, and how many matches of each photo (n,) agree with it.

    It is tested when as many photos agree as `wanted_supporters`.
    """

    enu_from_level: Similarity
    inliers: NDArray[np.intp]
    wanted_supporters: int = 1
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
        self._places: list[_Place] = []
        self._samples = samples_of(evidence.photos, SAMPLES, evidence.rng)

    def run(self) -> Registration:
        """Rounds of one new tile per photo and of tests, until the answer is decisive or nothing is left."""
        photos = [k for k, points in enumerate(self._samples) if np.isfinite(points).all()]
        order = np.argsort(-self._likely(), axis=1, kind="stable")
        while not self._spending.over() and not self._done[photos].all():
            for photo in photos:
                left = order[photo][~self._done[photo, order[photo]]]
                self._try(photo, left[:1])
            self._suggest(self._consensus(Pool.of(self._pairs)))
            confirmed = [self._test(place) for place in self._promising()]
            if any(confirmed) and self._decisive():
                break
        return self._conclude(with_icp=True)

    def _likely(self) -> Array:
        """How likely tiles (n photos, n tiles) are to show what photos show, before anything is matched."""
        tiles = self._evidence.airborne.tiles
        photos = [photo.raster for photo in self._evidence.photos]
        alike = self._options.retriever(photos, [tile.raster for tile in tiles])
        upright = np.array([[tile.upright for tile in tiles]])
        likely = _standardised(alike) + self._options.upright_weight * _standardised(upright)
        # Chance lets photos differ: if all began with the same wall, and it were the wrong one, all would be wrong.
        return np.asarray(likely + self._evidence.rng.gumbel(size=likely.shape))

    def _try(self, photo: int, tiles: NDArray[np.intp]) -> None:
        """Match a photo with those of the tiles that it was not matched with, as long as there is time."""
        for tile in tiles[~self._done[photo, tiles]]:
            if self._spending.over():
                return
            (pair,) = self._evidence.match(photo, [int(tile)])
            self._pairs.append(pair)
            self._done[photo, tile] = True
            self._spending.spent += 1
            self._progress(self._spending.spent, self._spending.limit)
            for place in self._places:
                place.inliers += self._inliers([pair], place.enu_from_level)
            self._suggest(self._evidence.hypothesis(pair.matches, level=True))

    def _suggest(self, placed: Similarity | None) -> None:
        """Remember a place, unless it is known."""
        if placed is None:
            return
        if all(self._evidence.apart_m(placed, p.enu_from_level) >= self._options.same_m for p in self._places):
            self._places.append(_Place(placed, self._inliers(self._pairs, placed)))

    def _promising(self) -> list[_Place]:
        """Places that no other photo was asked about, or that more agree with since; the best few."""
        waiting = [p for p in self._places if not p.confirmed and self._supporters(p) >= p.wanted_supporters]
        waiting.sort(key=lambda p: (self._supporters(p), int(p.inliers.sum())), reverse=True)
        return waiting[: self._options.tested]

    def _test(self, place: _Place) -> bool:
        """Look where other photos should look; if one agrees, look with all. Says whether that was so."""
        wanted = self._wanted(place.enu_from_level)
        agree = place.inliers >= self._options.consensus.min_photo_inliers
        others = [int(photo) for photo in np.argsort(-wanted.max(axis=1), kind="stable") if not agree[photo]]
        for photo in others[: self._options.probes]:
            self._try(photo, _best(wanted[photo], 1))
        self._refine(place)
        place.wanted_supporters = self._supporters(place) + 1
        if self._supporters(place) < 2:
            return False
        place.confirmed = True
        for photo, row in enumerate(self._wanted(place.enu_from_level)):
            self._try(photo, _best(row, self._options.seen_tiles))
        self._refine(place)
        return True

    def _refine(self, place: _Place) -> None:
        """Let all matches near a place decide where it is: one pair alone fixes its heading poorly."""
        pool = Pool.of(self._pairs)
        refined = self._consensus(pool.take(pool.gaps_m(place.enu_from_level) <= self._options.same_m))
        if refined is None:
            return
        inliers = self._inliers(self._pairs, refined)
        if inliers.sum() >= place.inliers.sum():
            place.enu_from_level, place.inliers = refined, inliers

    def _consensus(self, pool: Pool) -> Similarity | None:
        """What matches of several pairs say together: two of them and gravity make a hypothesis."""
        return self._evidence.hypothesis(pool.matches, level=True)

    def _wanted(self, placed: Similarity) -> Array:
        """How well tiles (n photos, n tiles) should show what photos show, if this is the place; 0 if not at all.

        A render that looks the way the photo looks is preferred: it sees the same sides of things.
        """
        airborne, options = self._evidence.airborne, self._options
        shares = shown_shares(airborne, placed.apply(self._samples), options.reach_m)
        looks = np.array([photo.forward_level for photo in self._evidence.photos]) @ placed.rotation.T
        forward = np.array([airborne.forward_enu(tile.render) for tile in airborne.tiles])
        alike = (1 + looks[:, :2] @ forward[:, :2].T) / 2
        return np.where((shares >= options.min_shown) & self._usable, shares * alike, 0.0)

    def _inliers(self, pairs: Sequence[PairEvidence], placed: Similarity) -> NDArray[np.intp]:
        """Matches of each photo (n,) that agree with a place."""
        pool = Pool.of(pairs)
        near = pool.gaps_m(placed) <= self._options.consensus.inlier_m
        return np.bincount(pool.photo[near], minlength=len(self._evidence.photos))

    def _supporters(self, place: _Place) -> int:
        return int(np.count_nonzero(place.inliers >= self._options.consensus.min_photo_inliers))

    def _decisive(self) -> bool:
        found = self._conclude(with_icp=False)
        d = found.diagnostics
        return found.registered and d["score"] >= self._options.decisive_margin * d["second_score"]

    def _conclude(self, *, with_icp: bool) -> Registration:
        places = [place.enu_from_level for place in self._places]
        return self._evidence.conclude(self._pairs, places, with_icp=with_icp)


def _best(row: Array, count: int) -> NDArray[np.intp]:
    """The tiles that are wanted most, none that is not wanted."""
    order = np.argsort(-row, kind="stable")[:count]
    return order[row[order] > 0]


def _standardised(rows: Array) -> Array:
    """Rows without their mean, in standard deviations."""
    return np.asarray((rows - rows.mean(axis=1, keepdims=True)) / (rows.std(axis=1, keepdims=True) + 1e-12))
