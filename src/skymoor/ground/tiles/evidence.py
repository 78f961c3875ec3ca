# SPDX-License-Identifier: Apache-2.0
"""Matches of photos with tiles, and the one similarity that most of them agree on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from skymoor.engines.batches import match_many
from skymoor.errors import DegenerateGeometry, TooFewMatches
from skymoor.geometry import Similarity, ransac_similarity
from skymoor.ground.tiles.icp import IcpOptions, IcpResult, refine_icp
from skymoor.ground.tiles.images import AirborneTiles, GroundPhoto, TileImageOptions, lift_pair
from skymoor.match import CyclicOptions, DenseMatcher, cyclic_matches
from skymoor.registration import RegisterOptions, independent_cells, register, restated
from skymoor.registration.criteria import ESTIMATE, criterion, with_criteria
from skymoor.types import Array, Criterion, Mask, Matches3D, Registration, Warp


@dataclass(frozen=True)
class ConsensusOptions:
    """From matches to one similarity per component, and when it is accepted.

    Attributes:
        best_tiles: tiles per photo, by number of matches, whose own transform is a hypothesis (the paper's k).
        inlier_m: largest residual of an inlier (the paper's).
        min_pair_matches: a pair with fewer yields no hypothesis.
        matches_per_pair: drawn at random for the consensus, so that all pairs have equal weight.
        min_scale, max_scale: metres per unit of the ground model.
        max_trials: of RANSAC, per pair.
        min_inlier_ratio: over the matches of each photo's best tiles; less is a refusal (the paper's).
        min_photos, min_photo_inliers: photos that must agree, each with so many inliers: a repeated facade can mislead
            one photo.
        min_margin, apart_m: the best transform must have that many times the inliers of any that maps the model's
            points at least so far away, on average.
        min_cells, cell_m: cubes in space that hold inliers.
        max_tilt_deg: by which the transform may tilt the levelled model.
        pictures, cyclic, register, icp: of the steps; no `icp` leaves that step out.
    """

    best_tiles: int = 5
    inlier_m: float = 0.5
    min_pair_matches: int = 30
    matches_per_pair: int = 300
    min_scale: float = 0.0
    max_scale: float = float("inf")
    max_trials: int = 2048
    min_inlier_ratio: float = 0.2
    min_photos: int = 3
    min_photo_inliers: int = 20
    min_margin: float = 1.25
    apart_m: float = 5.0
    min_cells: int = 10
    cell_m: float = 2.0
    max_tilt_deg: float = 6.0
    pictures: TileImageOptions = field(default_factory=TileImageOptions)
    cyclic: CyclicOptions = field(default_factory=lambda: CyclicOptions(max_matches=1_000_000))
    register: RegisterOptions = field(
        default_factory=lambda: RegisterOptions(inlier_m=0.5, correlation_m=3.0, tilt_sigma_deg=1.0)
    )
    icp: IcpOptions | None = field(default_factory=IcpOptions)


@dataclass(frozen=True, eq=False)
class PairEvidence:
    """Matches of a photo with a tile, at most `matches_per_pair` of the `count` that were found."""

    photo: int
    tile: int
    count: int
    matches: Matches3D


@dataclass(frozen=True, eq=False)
class Pool:
    """Matches (n) of many pairs, with the photo (n,) that each is of."""

    matches: Matches3D
    photo: NDArray[np.intp]

    @classmethod
    def of(cls, pairs: Sequence[PairEvidence]) -> Pool:
        """All matches of the pairs."""
        sizes = [len(pair.matches) for pair in pairs]
        photo = np.repeat(np.array([pair.photo for pair in pairs], dtype=np.intp), sizes)
        return cls(Matches3D.joined([pair.matches for pair in pairs]), photo)

    def take(self, index: Mask) -> Pool:
        """Keep some of the matches."""
        return Pool(self.matches.take(index), self.photo[index])

    def gaps_m(self, enu_from_level: Similarity) -> Array:
        """Residual distances (n,) of a transform."""
        gaps: Array = np.linalg.norm(enu_from_level.apply(self.matches.xyz_level) - self.matches.xyz_enu, axis=1)
        return gaps


@dataclass(frozen=True, eq=False)
class Evidence:
    """One component against one set of tiles: inputs and options of the matching."""

    photos: tuple[GroundPhoto, ...]
    airborne: AirborneTiles
    matcher: DenseMatcher
    options: ConsensusOptions
    probes: Array
    rng: np.random.Generator

    def match(self, photo: int, tiles: Sequence[int]) -> Iterator[PairEvidence]:
        """The cyclically consistent matches of a photo with each tile that have a point on both sides."""
        pairs = ((self.photos[photo].raster, self.airborne.tiles[tile].raster) for tile in tiles)
        for tile, warp in zip(tiles, match_many(self.matcher, pairs), strict=True):
            yield self._evidence(photo, tile, warp)

    def _evidence(self, photo: int, tile: int, warp: Warp) -> PairEvidence:
        options, a, b = self.options, self.photos[photo], self.airborne.tiles[tile]
        matches = lift_pair(cyclic_matches(warp, options.cyclic, rng=self.rng), a, b)
        count = len(matches)
        if count > options.matches_per_pair:
            index = np.sort(self.rng.choice(count, options.matches_per_pair, replace=False))
            matches = matches.take(index)
        return PairEvidence(photo, tile, count, matches)

    def hypothesis(self, matches: Matches3D, *, level: bool) -> Similarity | None:
        """The similarity of some matches alone; None where they are too few or do not agree."""
        o = self.options
        if len(matches) < o.min_pair_matches:
            return None
        try:
            found = ransac_similarity(
                matches.xyz_level,
                matches.xyz_enu,
                inlier_m=o.inlier_m,
                rng=self.rng,
                level=level,
                max_trials=o.max_trials,
                min_scale=o.min_scale,
                max_scale=o.max_scale,
            )
        except (TooFewMatches, DegenerateGeometry):
            return None
        return found.transform if found.inliers.sum() >= o.min_photo_inliers // 2 else None

    def best_pairs(self, pairs: Sequence[PairEvidence]) -> list[PairEvidence]:
        """The `best_tiles` of each photo by number of matches, without those of too few matches."""
        chosen = []
        for photo in range(len(self.photos)):
            own = [pair for pair in pairs if pair.photo == photo and pair.count >= self.options.min_pair_matches]
            chosen += sorted(own, key=lambda pair: -pair.count)[: self.options.best_tiles]
        return chosen

    def apart_m(self, a: Similarity, b: Similarity) -> float:
        """Mean distance between the component under two transforms."""
        return float(np.linalg.norm(a.apply(self.probes) - b.apply(self.probes), axis=1).mean())

    def conclude(
        self, pairs: Sequence[PairEvidence], hypotheses: Sequence[Similarity], *, with_icp: bool = True
    ) -> Registration:
        """The hypothesis that explains most matches, refitted to them and to the surface, accepted or refused."""
        o, pool = self.options, Pool.of(pairs)
        found_any = criterion("tile_hypotheses", len(hypotheses), 1)
        if not hypotheses:
            return with_criteria(_not_registered(pool, {"pairs": float(len(pairs))}), [found_any])
        scores = np.array([np.count_nonzero(pool.gaps_m(h) <= o.inlier_m) for h in hypotheses])
        best = int(np.argmax(scores))
        found = self._refitted(hypotheses[best], pool, with_covariance=with_icp)
        estimated = [found_any, criterion(ESTIMATE, found.registered, 1)]
        if found.enu_from_level is None:
            return with_criteria(found, estimated)
        enu_from_level = found.enu_from_level
        icp = self._icp(enu_from_level, pool) if with_icp else None
        if icp is not None and icp.helped:
            enu_from_level = icp.target_from_source
        elsewhere = [s for s, h in zip(scores, hypotheses, strict=True) if self.apart_m(h, enu_from_level) >= o.apart_m]
        score = int(np.count_nonzero(pool.gaps_m(enu_from_level) <= o.inlier_m))
        counts = {"score": float(score), "second_score": float(max(elsewhere, default=0)), **_icp_diagnostics(icp)}
        counts["photos_agree"] = float(len(self.supporters(enu_from_level, pool)))
        found = self._restated(replace(found, enu_from_level=enu_from_level), Pool.of(self.best_pairs(pairs)), counts)
        return with_criteria(found, [*estimated, *_criteria(found, o)])

    def supporters(self, enu_from_level: Similarity, pool: Pool) -> NDArray[np.intp]:
        """The photos with enough inliers."""
        near = pool.gaps_m(enu_from_level) <= self.options.inlier_m
        inliers = np.bincount(pool.photo[near], minlength=len(self.photos))
        return np.flatnonzero(inliers >= self.options.min_photo_inliers)

    def _refitted(self, start: Similarity, pool: Pool, *, with_covariance: bool) -> Registration:
        """Fitted to the matches near it, then to those near the fit."""
        enu_from_level, found = start, _not_registered(pool, {})
        for round_ in range(2):
            near = pool.take(pool.gaps_m(enu_from_level) <= 1.5 * self.options.inlier_m)
            found = register(
                near.matches,
                self.airborne.pixel_m,
                self.options.register,
                rng=self.rng,
                with_covariance=with_covariance and round_ == 1,
            )
            if found.enu_from_level is None:
                break
            enu_from_level = found.enu_from_level
        return found

    def _icp(self, enu_from_level: Similarity, pool: Pool) -> IcpResult | None:
        """ICP on all points of both sides; discarded where the matches contradict it."""
        o = self.options
        if o.icp is None:
            return None
        ground = np.concatenate([photo.known_level for photo in self.photos])
        air = np.concatenate([xyz[np.isfinite(xyz[..., 0])] for xyz in self.airborne.xyz_enu])
        try:
            found = refine_icp(ground, air, enu_from_level, o.icp)
        except TooFewMatches:
            return None
        before, after = (
            np.count_nonzero(pool.gaps_m(t) <= o.inlier_m) for t in (enu_from_level, found.target_from_source)
        )
        if after < 0.95 * before:
            return replace(found, target_from_source=enu_from_level, reason="the matches contradict it")
        return found

    def _restated(self, found: Registration, pool: Pool, counts: dict[str, float]) -> Registration:
        """The registration with inliers and residuals of the matches of each photo's best tiles."""
        o, enu_from_level = self.options, found.enu_from_level
        assert enu_from_level is not None
        found = restated(found, enu_from_level, pool.matches, o.inlier_m)
        cells = independent_cells(pool.matches.xyz_enu[found.inliers], o.cell_m)
        return replace(found, diagnostics={**counts, "cells": float(cells)})


def evidence_of(
    photos: tuple[GroundPhoto, ...],
    airborne: AirborneTiles,
    matcher: DenseMatcher,
    options: ConsensusOptions,
    rng: np.random.Generator,
) -> Evidence:
    """Prepare the matching. Raises `DegenerateGeometry` where no photo has a point."""
    known = [points for points in (photo.known_level for photo in photos) if len(points)]
    if not known:
        raise DegenerateGeometry("no ground photo has a depth map, which is needed to lift its matches")
    probes = np.concatenate([points[rng.integers(0, len(points), 20)] for points in known])
    return Evidence(photos, airborne, matcher, options, probes, rng)


def _criteria(found: Registration, o: ConsensusOptions) -> list[Criterion]:
    """Criteria of an estimated transform."""
    d = found.diagnostics
    return [
        criterion("inlier_ratio", found.inlier_ratio, o.min_inlier_ratio),
        criterion("agreeing_photos", d["photos_agree"], o.min_photos),
        criterion("competing_inliers", d["score"], o.min_margin * d["second_score"]),
        criterion("cells", d["cells"], o.min_cells),
        criterion("tilt", found.tilt_deg, o.max_tilt_deg),
    ]


def _not_registered(pool: Pool, diagnostics: dict[str, float]) -> Registration:
    return Registration(
        registered=False, reason="", enu_from_level=None, n_matches=len(pool.matches), diagnostics=diagnostics
    )


def _icp_diagnostics(icp: IcpResult | None) -> dict[str, float]:
    if icp is None:
        return {}
    return {"icp_helped": float(icp.helped), "icp_moved_m": icp.moved_m, "icp_overlap": icp.overlap}
