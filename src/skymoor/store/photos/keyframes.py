# SPDX-License-Identifier: Apache-2.0
"""Which frames of a video become photos: sharp ones that overlap by as much as photos of a flight do.

From frame to frame, corners are tracked (Lucas and Kanade, 1981; Bouguet, 2000) and a similarity of the image is fitted
to them. Similarities in a row say which part of one frame another one still shows. What no similarity explains is
parallax: a camera that circles around a building keeps it in the middle of the image, and yet sees other sides of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from skymoor.errors import InputError
from skymoor.types import Array, Array32, Image

TRACKED_PX = 480
"""Long side of the copies that corners are tracked in."""
WINDOW_PX, LEVELS = (21, 21), 4
CORNERS, FEWEST_TRACKS = 400, 12
ROUND_TRIP_PX, FIT_PX = 1.0, 2.0
LARGEST_PX = 20.0
"""Residuals count up to it: a few tracks are wrong."""
NOISE_PX = 0.4
"""Residuals of tracks below it are noise of tracking, and no parallax."""
NEIGHBOURS = 10
BLURRED = 0.5
"""A frame with less than this share of its neighbours' sharpness is blurred: by motion, or while focusing."""
LEAST_OVERLAP = 0.4
"""To which the next frame may fall where all better ones are blurred; below, photos hardly connect."""


MOST_FPS = 240


@dataclass(frozen=True)
class VideoOptions:
    """How videos become photos.

    Attributes:
        fps: frames per second that are looked at.
        min_overlap, max_overlap: with the frame before it that is kept; the sharpest in between is kept next.
    """

    fps: float = 6.0
    min_overlap: float = 0.7
    max_overlap: float = 0.9

    def check(self) -> None:
        """Raises `InputError` for values that choose nothing."""
        if not 0 < self.fps <= MOST_FPS:
            raise InputError(f"video.fps = {self.fps}: give frames per second above 0, at most {MOST_FPS}")
        if not 0 < self.min_overlap < self.max_overlap < 1:
            raise InputError(
                f"video.min_overlap = {self.min_overlap}, video.max_overlap = {self.max_overlap}: give two shares "
                "between 0 and 1, the smaller one first"
            )


@dataclass(frozen=True, eq=False)
class Look:
    """A frame that was looked at.

    Attributes:
        number: of the frame in the video.
        sharpness: variance of the Laplacian, in units of that of the image; 0 where there are no corners to track.
        from_last: (2, 3) similarity from pixels of the last look to those of this one; None where the two have too
            little in common.
        parallax: mean residual of the tracks, as a share of the image's long side.
    """

    number: int
    sharpness: float
    from_last: Array | None = None
    parallax: float = 0.0


class Looker:
    """Looks at the frames of one video, one after the other."""

    def __init__(self) -> None:
        self._last: tuple[Image, Array32] | None = None
        self.size = (0, 0)  # (width, height) of the copies

    def __call__(self, number: int, grey: Image) -> Look:
        """Compare a grey frame (h, w) with the last one."""
        ratio = min(1.0, TRACKED_PX / max(grey.shape))
        small = cv2.resize(grey, None, fx=ratio, fy=ratio, interpolation=cv2.INTER_AREA)
        self.size = (small.shape[1], small.shape[0])
        found = cv2.goodFeaturesToTrack(small, CORNERS, 0.01, 7)
        corners = np.asarray([] if found is None else found, np.float32).reshape(-1, 2)
        last, self._last = self._last, (small, corners)
        if len(corners) < FEWEST_TRACKS:
            return Look(number, 0.0)
        fitted = None if last is None else _similarity(*last, small)
        sharpness = float(cv2.Laplacian(grey, cv2.CV_32F).var() / max(float(grey.var()), 1.0))
        if fitted is None:
            return Look(number, sharpness)
        from_last, residual_px = fitted
        return Look(number, sharpness, from_last, max(0.0, residual_px - NOISE_PX) / max(self.size))


def _similarity(last: Image, corners: Array32, current: Image) -> tuple[Array, float] | None:
    """(2, 3) from the last image to the current one, and the mean residual in pixels of all tracks.

    The mean, because what is circled around may be more than half of the image, and stays where it is.
    """
    if len(corners) < FEWEST_TRACKS:
        return None
    there, found, _ = cv2.calcOpticalFlowPyrLK(last, current, corners, None, winSize=WINDOW_PX, maxLevel=LEVELS)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(current, last, there, None, winSize=WINDOW_PX, maxLevel=LEVELS)
    good = (found[:, 0] > 0) & (returned[:, 0] > 0) & (np.linalg.norm(back - corners, axis=1) < ROUND_TRIP_PX)
    if good.sum() < FEWEST_TRACKS:
        return None
    fitted, inliers = cv2.estimateAffinePartial2D(corners[good], there[good], ransacReprojThreshold=FIT_PX)
    if fitted is None or inliers.sum() < FEWEST_TRACKS:
        return None
    residuals = np.linalg.norm(corners[good] @ fitted[:, :2].T + fitted[:, 2] - there[good], axis=1)
    return fitted, float(np.minimum(residuals, LARGEST_PX).mean())


def choose_frames(looks: Sequence[Look], size: tuple[int, int], options: VideoOptions) -> list[int]:
    """Numbers of the frames to keep, of all looks in their order; `size` (width, height) is that of `Looker`.

    Frames that show the same as the one before them are left out, and so are blurred ones where a sharper one overlaps
    enough.
    """
    usable = _usable(looks)
    chosen: list[int] = []
    start: int | None = next((k for k in range(len(looks)) if usable[k]), None)
    if start is not None:
        chosen.append(_sharpest_alike(looks, start, size, options.max_overlap))
    while chosen:
        following = _next(looks, chosen[-1], usable, size, options)
        if following is None:
            break
        chosen.append(following)
    return [looks[k].number for k in chosen]


def _usable(looks: Sequence[Look]) -> list[bool]:
    sharpness = np.array([look.sharpness for look in looks])
    around = [sharpness[max(0, k - NEIGHBOURS) : k + NEIGHBOURS + 1] for k in range(len(looks))]
    return [
        bool(value > 0 and value >= BLURRED * np.median(near)) for value, near in zip(sharpness, around, strict=True)
    ]


def _next(
    looks: Sequence[Look], kept: int, usable: Sequence[bool], size: tuple[int, int], options: VideoOptions
) -> int | None:
    """The look to keep after `kept`; None where the rest shows the same."""
    ideal: list[int] = []
    far: list[int] = []
    lost = len(looks)
    for k, overlap in _overlaps(looks, kept, size):
        if overlap < LEAST_OVERLAP:
            lost = k
            break
        if overlap <= options.max_overlap:
            (ideal if overlap >= options.min_overlap else far).append(k)
    sharp = [i for i in ideal if usable[i]]
    if sharp:
        return max(sharp, key=lambda i: looks[i].sharpness)
    if any(usable[i] for i in far):
        return next(i for i in far if usable[i])
    if ideal or far:
        return max(ideal or far, key=lambda i: looks[i].sharpness)
    # A cut, or a motion that is too fast to follow: what comes begins anew.
    start = next((i for i in range(lost, len(looks)) if usable[i]), None)
    return None if start is None else _sharpest_alike(looks, start, size, options.max_overlap)


def _sharpest_alike(looks: Sequence[Look], start: int, size: tuple[int, int], max_overlap: float) -> int:
    """The sharpest of the looks from `start` on that show the same."""
    alike = [start]
    for k, overlap in _overlaps(looks, start, size):
        if overlap <= max_overlap:
            break
        alike.append(k)
    return max(alike, key=lambda k: looks[k].sharpness)


def _overlaps(looks: Sequence[Look], start: int, size: tuple[int, int]) -> Iterator[tuple[int, float]]:
    """The looks after `start` and the share of it that each still shows, 0 from where it is lost."""
    frame = np.array([[0, 0], [size[0], 0], [size[0], size[1]], [0, size[1]]], np.float32)
    current_from_start, parallax = np.eye(3), 0.0
    for k in range(start + 1, len(looks)):
        step = looks[k].from_last
        if step is None:
            yield k, 0.0
            return
        current_from_start = np.vstack([step, [0, 0, 1]]) @ current_from_start
        parallax += looks[k].parallax
        corners = (frame @ current_from_start[:2, :2].T + current_from_start[:2, 2]).astype(np.float32)
        shared = float(cv2.intersectConvexConvex(frame, corners)[0])
        # Of the larger of the two: zooming in shows no other part, and yet less of it.
        areas = (size[0] * size[1], float(cv2.contourArea(corners)))
        yield k, shared / max(*areas, 1.0) * max(0.0, 1 - parallax)
