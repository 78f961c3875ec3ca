# SPDX-License-Identifier: Apache-2.0
"""Videos of known motion, with known blur and standstill, and which of their frames become photos."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from skymoor.errors import InputError
from skymoor.store import Store, VideoOptions, count_frames, find_photos
from skymoor.store.photos import write_frames

av = pytest.importorskip("av")

WIDTH, HEIGHT = 320, 240
Frame = NDArray[np.uint8]


def ground(width: int = 2400) -> Frame:
    """Texture at several scales."""
    rng = np.random.default_rng(4)
    sizes = (1.5, 4, 12)
    layers = [cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT + 80, width)), (0, 0), s) * s for s in sizes]
    grey = sum(layers)
    return np.clip(120 + 45 * grey / grey.std(), 0, 255).astype(np.uint8)


GROUND = ground()


def seen(shift_px: float, blur_px: float = 0.0) -> Frame:
    """The ground below a camera that has moved by so many pixels."""
    view = cv2.getRectSubPix(GROUND, (WIDTH, HEIGHT), (WIDTH / 2 + 20 + shift_px, HEIGHT / 2 + 20))
    return cv2.GaussianBlur(view, (0, 0), blur_px) if blur_px else view


def write_video(path: Path, frames: Sequence[Frame], rate: int = 6) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = WIDTH, HEIGHT, "yuv420p", 8_000_000
        stream.time_base = Fraction(1, rate)
        for frame in frames:
            rgb = np.repeat(frame[..., None], 3, axis=2)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
        container.mux(stream.encode())
    return path


def chosen(video: Path, tmp_path: Path, options: VideoOptions | None = None) -> list[int]:
    folder = tmp_path / "frames"
    folder.mkdir(exist_ok=True)
    return [int(Path(name).stem) for name in write_frames(video, folder, options or VideoOptions())]


def test_neighbours_overlap_as_asked(tmp_path: Path) -> None:
    """8 pixels of 320 a frame: 70 to 90 percent are 4 to 12 frames, whatever the rate that is looked at."""
    video = write_video(tmp_path / "v.mp4", [seen(8 * k) for k in range(60)])
    kept = chosen(video, tmp_path)
    steps = np.diff(kept)
    assert (steps >= 4).all() and (steps <= 12).all() and len(kept) >= 6
    wide = chosen(video, tmp_path, VideoOptions(min_overlap=0.88, max_overlap=0.96))
    assert (np.diff(wide) >= 2).all() and (np.diff(wide) <= 4).all()
    assert count_frames(video, VideoOptions()) == (len(kept), (WIDTH, HEIGHT))
    half = chosen(video, tmp_path, VideoOptions(fps=3))
    assert all(number % 2 == 0 for number in half) and len(half) >= 5


def test_blurred_frames_are_left_out(tmp_path: Path) -> None:
    blurred = {k for k in range(60) if k % 5 in (1, 2, 3)}
    frames = [seen(8 * k, 2.5 if k in blurred else 0.0) for k in range(60)]
    kept = chosen(write_video(tmp_path / "v.mp4", frames), tmp_path)
    assert not blurred & set(kept)
    assert len(kept) >= 6 and (np.diff(kept) <= 12).all()


def test_a_standstill_adds_nothing(tmp_path: Path) -> None:
    shifts = [*(8 * k for k in range(20)), *([152] * 60), *(152 + 8 * k for k in range(20))]
    kept = chosen(write_video(tmp_path / "v.mp4", [seen(shift) for shift in shifts]), tmp_path)
    assert sum(20 <= number < 80 for number in kept) <= 1
    assert 4 <= len(kept) <= 9


def test_a_cut_and_a_dark_lens_do_not_end_the_video(tmp_path: Path) -> None:
    dark = [np.full((HEIGHT, WIDTH), 12, np.uint8)] * 12
    frames = [*(seen(8 * k) for k in range(15)), *dark, *(seen(1200 + 8 * k) for k in range(15))]
    kept = chosen(write_video(tmp_path / "v.mp4", frames), tmp_path)
    assert sum(number < 15 for number in kept) >= 2 and sum(number >= 27 for number in kept) >= 2
    assert not [number for number in kept if 15 <= number < 27]


def test_a_circle_around_something_is_motion_though_it_stays_in_the_middle(tmp_path: Path) -> None:
    """More than half of the image is at the distance of the axis; stripes of it are nearer and farther."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    depth = np.select([v < 50, v > 190], [1.0, -1.0], 0.0).astype(np.float32)

    def circled(px: float) -> list[Frame]:
        return [cv2.remap(GROUND, u + 900 + px * k * depth, v + 20, cv2.INTER_LINEAR) for k in range(120)]

    kept = chosen(write_video(tmp_path / "v.mp4", circled(5.0)), tmp_path)
    assert 3 <= len(kept) <= 8
    assert len(chosen(write_video(tmp_path / "still.mp4", circled(0.0)), tmp_path)) == 1


def site_with(tmp_path: Path, frames: int = 40) -> Path:
    (tmp_path / "air").mkdir()
    return write_video(tmp_path / "air/flight.mp4", [seen(8 * k) for k in range(frames)])


def test_frames_are_photos_of_the_run_and_decoded_once(tmp_path: Path) -> None:
    video = site_with(tmp_path)
    found = find_photos([tmp_path / "air"], tmp_path)
    out = tmp_path / "out"
    with Store.open(out) as store:
        first = store.photos("photos", found)
        assert [record.name for record in store.records] == ["photos.video0", "photos"]
    assert len(first) >= 4 and all(name.startswith("air/flight.mp4/0") for name in first.names)
    number = int(Path(first.names[1]).stem)
    gap = first.read(first.names[1])[..., 0].astype(int) - seen(8 * number)
    assert first.sizes[1] == (WIDTH, HEIGHT) and np.abs(gap).mean() < 6
    with Store.open(out) as store:
        again = store.photos("photos", found)
        assert all(record.cached for record in store.records)
    assert (again.names, again.content) == (first.names, first.content)
    # A frame that was spoilt, or lost, is written again; another setting is another choice.
    spoilt = out / "frames" / first.names[2]
    spoilt.write_bytes(b"?")
    with Store.open(out) as store:
        assert store.photos("photos", found).content == first.content
    shutil.rmtree(out / "frames")
    with Store.open(out) as store:
        assert store.photos("photos", found).content == first.content
    with Store.open(out) as store:
        other = store.photos("photos", found, VideoOptions(min_overlap=0.88, max_overlap=0.96))
    assert len(other) > len(first)
    assert sorted(path.name for path in (out / "frames/air/flight.mp4").iterdir()) == sorted(
        Path(name).name for name in other.names
    )
    assert video.is_file()


def test_a_video_too_short_for_a_set_is_told(tmp_path: Path) -> None:
    site_with(tmp_path, frames=4)
    found = find_photos([tmp_path / "air"], tmp_path)
    with Store.open(tmp_path / "out") as store, pytest.raises(InputError, match=r"flight\.mp4: has 1 images, at least"):
        store.photos("photos", found)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello",
        b"#EXTM3U\n#EXTINF:1,\nfile:///etc/hostname\n#EXT-X-ENDLIST\n",
        b"ffconcat version 1.0\nfile x.mp4\n",
    ],
    ids=["nothing", "text", "playlist", "list of files"],
)
def test_what_is_no_video_is_named(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "v.mp4"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"v\.mp4: is damaged or not a video"):
        write_frames(path, tmp_path, VideoOptions())
    assert [file.name for file in tmp_path.iterdir()] == ["v.mp4"]


def test_damage_anywhere_is_decoded_or_refused_by_name(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "v.mp4", [seen(8 * k) for k in range(8)]).read_bytes()
    rng, path = np.random.default_rng(2), tmp_path / "x.mp4"
    for k in range(25):
        spoilt = bytearray(whole[: len(whole) // 2] if k % 5 == 0 else whole)
        for place in rng.integers(0, len(spoilt) if k % 2 else 300, 4):
            spoilt[place] = rng.integers(256)
        path.write_bytes(spoilt)
        folder = tmp_path / f"{k}"
        folder.mkdir()
        try:
            write_frames(path, folder, VideoOptions())
        except InputError as error:
            assert "x.mp4" in str(error)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (VideoOptions(fps=0), "video.fps"),
        (VideoOptions(fps=float("nan")), "video.fps"),
        (VideoOptions(min_overlap=0.9, max_overlap=0.7), "video.min_overlap"),
        (VideoOptions(max_overlap=1.0), "video.max_overlap"),
    ],
)
def test_settings_that_choose_nothing(options: VideoOptions, named: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=named):
        write_frames(write_video(tmp_path / "v.mp4", [seen(0)] * 3), tmp_path, options)
