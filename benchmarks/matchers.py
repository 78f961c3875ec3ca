# SPDX-License-Identifier: Apache-2.0
"""Matchers side by side on real pairs of pictures from different worlds.

    python benchmarks/matchers.py PAIRS_FOLDER [--weights DIR] [--results FILE]

PAIRS_FOLDER holds index.csv (pair, kind, affine_rmse_px, ...) and for each pair NAME_a.png, NAME_b.png and NAME.csv
with landmarks clicked by hand (x, y in a, x, y in b, counted from 1). Each pair is matched in two ways: "laid", after
the similarity that fits the landmarks has laid a on b and a known turn, stretch and shift were added, as a search
leaves them; and "searched", after the search over headings and scales that skymoor puts in front. A pair is right if
the affine that fits the matches takes the landmarks to within 5 pixels in the median, or 1.5 times of what the best
affine leaves. Engines whose libraries or weights are missing are named and left out.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from skymoor.engines.weights import weights_folder
from skymoor.errors import BackendUnavailable
from skymoor.match import (
    AlikedMatcher,
    DenseMatcher,
    LoftrMatcher,
    RomaMatcher,
    StructuralMatcher,
    TinyRomaMatcher,
    match_hypothesis,
    search_hypotheses,
)
from skymoor.match.flow import warp_from_pairs
from skymoor.types import Matches2D, Raster, Warp

Array = NDArray[np.float64]
RIGHT_PX = 5.0
FAILED_PX = 9999.0  # of a pair without an affine
TURN_DEG, STRETCH, SHIFT_PX = 1.0, 1.01, (2.0, -1.5)


@dataclass(frozen=True)
class SiftMatcher:
    """SIFT with the ratio test, each other's nearest."""

    max_ratio: float = 0.85

    def __call__(self, a: Raster, b: Raster) -> Warp:
        (px_a, from_a), (px_b, from_b) = (self._described(raster) for raster in (a, b))
        if min(len(px_a), len(px_b)) < 2:
            return warp_from_pairs(a, b, [], [], [])
        best = cv2.BFMatcher(cv2.NORM_L2).knnMatch(from_a, from_b, k=2)
        back = cv2.BFMatcher(cv2.NORM_L2).match(from_b, from_a)
        mutual = {m.queryIdx: m.trainIdx for m in back}
        kept = [m for m, n in best if m.distance < self.max_ratio * n.distance and mutual[m.trainIdx] == m.queryIdx]
        i, j = [m.queryIdx for m in kept], [m.trainIdx for m in kept]
        return warp_from_pairs(a, b, px_a[i], px_b[j], np.ones(len(kept)))

    def _described(self, raster: Raster) -> tuple[Array, NDArray[np.float32]]:
        grey = cv2.cvtColor(raster.rgb, cv2.COLOR_RGB2GRAY)
        points, described = cv2.SIFT_create(4096).detectAndCompute(grey, raster.mask.astype(np.uint8) * 255)
        return np.array([p.pt for p in points]).reshape(-1, 2) + 0.5, described


MATCHERS: tuple[DenseMatcher, ...] = (
    SiftMatcher(),
    AlikedMatcher(),
    StructuralMatcher(),
    TinyRomaMatcher(),
    LoftrMatcher(),
    RomaMatcher(),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pairs", type=Path)
    parser.add_argument("--weights", type=Path, help="as SKYMOOR_WEIGHTS")
    parser.add_argument("--results", type=Path, default=Path("benchmarks/results/matchers.json"))
    arguments = parser.parse_args()
    if arguments.weights:
        os.environ["SKYMOOR_WEIGHTS"] = str(arguments.weights.resolve())
    with (arguments.pairs / "index.csv").open() as file:
        index = list(csv.DictReader(file))
    rows: list[dict[str, Any]] = []
    left_out: dict[str, str] = {}
    for line in index:
        rows += measured(arguments.pairs, line, left_out)
    summary = [line for m in MATCHERS for how in ("laid", "searched") for line in summed(type(m).__name__, how, rows)]
    for line in summary:
        print(line)
    arguments.results.parent.mkdir(parents=True, exist_ok=True)
    content = {"summary": summary, "left_out": left_out, "pairs": rows}
    arguments.results.write_text(json.dumps(content, indent=1) + "\n")


def measured(folder: Path, line: dict[str, str], left_out: dict[str, str]) -> list[dict[str, Any]]:
    """Rows of one pair; matchers that cannot run are added to `left_out`, with the reason."""
    a, b = (read(folder / f"{line['pair']}_{side}.png") for side in "ab")
    marks = np.loadtxt(folder / f"{line['pair']}.csv", delimiter=",", skiprows=1, usecols=(0, 1, 2, 3)) - 0.5
    similarity, _ = cv2.estimateAffinePartial2D(marks[:, :2].copy(), marks[:, 2:].copy(), method=cv2.LMEDS)
    laid = {"laid": disturbed(np.asarray(similarity, np.float64), a.mask.shape)}
    for hypothesis in search_hypotheses(a, b, min_scale=0.5, max_scale=2.0)[:1]:
        laid["searched"] = hypothesis.matrix(a.mask.shape)
    rows = []
    for matcher in MATCHERS:
        name = type(matcher).__name__
        for how in () if name in left_out else laid:
            try:
                row = one(matcher, a, b, laid[how], marks)
            except BackendUnavailable as error:
                left_out[name] = str(error).replace(f"{weights_folder()}/", "")
                print(f"{name} left out: {error}")
                break
            row["right"] = row["error_px"] <= max(RIGHT_PX, 1.5 * float(line["affine_rmse_px"]))
            rows.append({"matcher": name, "pair": line["pair"], "kind": line["kind"], "how": how, **row})
            print(rows[-1], flush=True)
    return rows


def one(matcher: DenseMatcher, a: Raster, b: Raster, b_from_a: Array, marks: Array) -> dict[str, Any]:
    """Figures of one matcher on one pair, laid so."""
    start = time.perf_counter()
    matches, _ = match_hypothesis(a, b, b_from_a, matcher, rng=np.random.default_rng(0))
    seconds = time.perf_counter() - start
    error, share = landmark_error(matches, marks)
    return {
        "error_px": round(error, 2),
        "matches": len(matches),
        "inlier_share": round(share, 3),
        "seconds": round(seconds, 2),
    }


def read(path: Path) -> Raster:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise SystemExit(f"{path}: cannot be read")
    return Raster(np.ascontiguousarray(picture[..., ::-1]), np.ones(picture.shape[:2], bool))


def disturbed(b_from_a: Array, shape: tuple[int, ...]) -> Array:
    """As good as a search leaves it: turned and stretched about the middle of a, and shifted."""
    turn, middle = np.radians(TURN_DEG), np.array([shape[1] / 2, shape[0] / 2])
    linear = b_from_a[:, :2] @ (STRETCH * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]))
    place = b_from_a[:, :2] @ middle + b_from_a[:, 2] + SHIFT_PX
    return np.column_stack([linear, place - linear @ middle])


def landmark_error(matches: Matches2D, marks: Array) -> tuple[float, float]:
    """Median distance, in pixels of b, of landmarks from where the matches' affine takes them; its inliers' share."""
    if len(matches) < 6:
        return FAILED_PX, 0.0
    affine, inliers = cv2.estimateAffine2D(matches.px_a, matches.px_b, method=cv2.RANSAC, ransacReprojThreshold=4.0)
    if affine is None:
        return FAILED_PX, 0.0
    there = marks[:, :2] @ affine[:, :2].T + affine[:, 2]
    return float(np.median(np.linalg.norm(there - marks[:, 2:], axis=1))), float(inliers.mean())


def summed(name: str, how: str, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One line, or none if the matcher was left out."""
    own = [row for row in rows if row["matcher"] == name and row["how"] == how]
    if not own:
        return []
    errors = [row["error_px"] for row in own if row["right"]]
    return [
        {
            "matcher": name,
            "how": how,
            "pairs": len(own),
            "right": sum(row["right"] for row in own),
            "median_error_px_of_right": round(float(np.median(errors)), 2) if errors else None,
            "median_matches": int(np.median([row["matches"] for row in own])),
            "median_seconds": round(float(np.median([row["seconds"] for row in own])), 2),
        }
    ]


if __name__ == "__main__":
    main()
