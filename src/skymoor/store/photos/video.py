# SPDX-License-Identifier: Apache-2.0
"""Frames of videos as photos. PyAV decodes them; it is optional."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from skymoor.engines.libraries import require
from skymoor.errors import InputError
from skymoor.store.photos.decode import require_size
from skymoor.store.photos.keyframes import Looker, VideoOptions, choose_frames
from skymoor.types import Progress, no_progress

LOOKED_AT_PX = 1280
"""Long side of the copies whose sharpness is measured: features are found in photos of a few times this size."""
JPEG_QUALITY = 95
# Containers that cameras write. Others are playlists, which would open further files, or streams of the network.
CONTAINERS = ("mov", "mp4", "matroska", "webm", "avi", "mpegts", "mpeg", "asf")
OPEN_OPTIONS = {"format_whitelist": ",".join(CONTAINERS), "protocol_whitelist": "file"}


def video_ready() -> None:
    """Raises `BackendUnavailable` where PyAV is not installed."""
    require("av", "video")


def count_frames(video: Path, options: VideoOptions, progress: Progress = no_progress) -> tuple[int, tuple[int, int]]:
    """How many frames would be photos, and their size (width, height). Errors as `write_frames`."""
    return len(_chosen(video, options, progress)), _size(video)


def write_frames(video: Path, folder: Path, options: VideoOptions, progress: Progress = no_progress) -> tuple[str, ...]:
    """Write the chosen frames into a folder as NUMBER.jpg, which counts the frames of the video; returns the names.

    The video is decoded twice: to choose, and to write, so that memory does not depend on its length. The rotation that
    players apply is ignored, like that of photos.

    Raises `BackendUnavailable` where PyAV is not installed, and `InputError` for a file that is no video of a known
    container, is damaged, or has frames of a size that no camera takes.
    """
    chosen = set(_chosen(video, options, lambda done, total, _="": progress(done, 2 * total)))
    names = []
    for number, frame, total in _frames(video, chosen):
        name = f"{number:06d}.jpg"
        Image.fromarray(frame.to_ndarray(format="rgb24")).save(folder / name, quality=JPEG_QUALITY, subsampling=0)
        names.append(name)
        progress(total + number, 2 * total)
    progress(len(names), len(names))
    return tuple(names)


def _chosen(video: Path, options: VideoOptions, progress: Progress) -> list[int]:
    options.check()
    looker, looks, due_s = Looker(), [], 0.0
    for number, frame, total in _frames(video):
        progress(number, total)
        time_s = float(frame.time) if frame.time is not None else due_s
        if time_s + 1e-6 < due_s:
            continue
        due_s = max(due_s + 1 / options.fps, time_s + 0.5 / options.fps)
        looks.append(looker(number, _grey(frame)))
    progress(len(looks), len(looks))
    if not looks:
        raise InputError(f"{video}: has no frames; remove it or copy it again")
    return choose_frames(looks, looker.size, options)


def _grey(frame: Any) -> NDArray[np.uint8]:
    grey = frame.to_ndarray(format="gray")
    ratio = min(1.0, LOOKED_AT_PX / max(grey.shape))
    return np.asarray(cv2.resize(grey, None, fx=ratio, fy=ratio, interpolation=cv2.INTER_AREA), np.uint8)


def _size(video: Path) -> tuple[int, int]:
    with _opened(video) as (_, stream):
        return int(stream.width), int(stream.height)


def _frames(video: Path, numbers: Collection[int] | None = None) -> Iterator[tuple[int, Any, int]]:
    """Number and content of every frame, or of these, and about how many there are."""
    with _opened(video) as (container, stream):
        stream.thread_type = "AUTO"
        size, last = (stream.width, stream.height), None if numbers is None else max(numbers, default=-1)
        total = stream.frames or int((container.duration or 0) / 1e6 * float(stream.average_rate or 30)) or 1
        for number, frame in enumerate(container.decode(stream)):
            if (frame.width, frame.height) != size:
                raise InputError(f"{video}: its frames change their size; cut it where they do")
            if last is not None and number > last:
                return
            if numbers is None or number in numbers:
                yield number, frame, max(total, number + 1)


@contextmanager
def _opened(video: Path) -> Iterator[tuple[Any, Any]]:
    """Container and first video stream."""
    av = require("av", "video")
    try:
        with av.open(str(video), options=OPEN_OPTIONS) as container:
            stream = next(iter(container.streams.video), None)
            if stream is None:
                raise InputError(f"{video}: has no video in it; remove it")
            require_size(stream.width, stream.height, video)
            yield container, stream
    except (FileNotFoundError, PermissionError) as error:
        raise InputError(f"{video}: cannot be read: {error.strerror}; put it back, or let it be read") from error
    except (av.error.FFmpegError, UnicodeDecodeError) as error:  # the latter of names in the file
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"{video}: is damaged or not a video that can be read ({reason}); remove it, copy it again "
            "or convert it to MP4"
        ) from error
