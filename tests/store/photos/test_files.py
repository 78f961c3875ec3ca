# SPDX-License-Identifier: Apache-2.0
"""Which files belong to a set of photos, and what is said of those that do not."""

from __future__ import annotations

import os
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from skymoor.errors import InputError
from skymoor.store import Store, find_photos, open_photos
from skymoor.store.photos.decode import _QUIET_PILLOW


def photo(path: Path, seed: int = 0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 256, (40, 60, 3), np.uint8)
    Image.fromarray(pixels).save(path, path.suffix[1:].upper().replace("JPG", "JPEG").replace("TIF", "TIFF"))
    return path


def empty(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"?")
    return path


@pytest.fixture
def air(tmp_path: Path) -> Path:
    """A folder as a drone's card has it: numbers begin anew in each sub-folder, and some lie at the top."""
    for k, name in enumerate(
        ("DJI_0003.JPG", "100MEDIA/DJI_0001.JPG", "100MEDIA/DJI_0002.JPG", "101MEDIA/DJI_0001.JPG")
    ):
        photo(tmp_path / "air" / name, k)
    return tmp_path / "air"


def names(*sources: Path, root: Path, others: tuple[Path, ...] = ()) -> list[str]:
    return [file.name for file in find_photos(sources, root, others).photos]


def test_sub_folders_are_read_and_told(air: Path, tmp_path: Path) -> None:
    found = find_photos([air], tmp_path)
    assert [file.name for file in found.photos] == [
        "air/100MEDIA/DJI_0001.JPG",
        "air/100MEDIA/DJI_0002.JPG",
        "air/101MEDIA/DJI_0001.JPG",
        "air/DJI_0003.JPG",
    ]
    assert found.notes == (f"{air}: 3 of 4 photos are in sub-folders: 100MEDIA (2), 101MEDIA (1)",)
    photos = open_photos(air, tmp_path)
    twins = [photos.read(f"air/{folder}/DJI_0001.JPG") for folder in ("100MEDIA", "101MEDIA")]
    assert np.abs(twins[0].astype(int) - twins[1]).mean() > 10  # each is its own file


def test_several_folders_are_one_set(air: Path, tmp_path: Path) -> None:
    second = photo(tmp_path / "second/DJI_0003.JPG").parent
    assert names(air, second, root=tmp_path)[-2:] == ["air/DJI_0003.JPG", "second/DJI_0003.JPG"]
    # A folder in another one of the same set: nothing counts twice.
    assert names(air, air / "100MEDIA", root=tmp_path) == names(air, root=tmp_path)


@pytest.mark.parametrize("folder", [".Trash", "@eaDir/a.jpg", "__MACOSX"])
def test_folders_of_others_are_passed_over(folder: str, air: Path, tmp_path: Path) -> None:
    before = find_photos([air], tmp_path)
    photo(air / folder / "thumb.jpg")
    assert find_photos([air], tmp_path) == before


def test_results_of_a_run_are_no_photos(air: Path, tmp_path: Path) -> None:
    before = find_photos([air], tmp_path)
    with Store.open(air / "result"):
        photo(air / "result/renders/nadir.png")
        assert find_photos([air], tmp_path) == before
    # The cache and the hidden lock may be gone, and a folder may have a summary of another program.
    for name in ("summary.json", "cameras.csv"):
        empty(air / "copied" / name)
    photo(air / "copied/renders/nadir.png")
    assert find_photos([air], tmp_path) == before
    photo(air / "flight/a.jpg"), empty(air / "flight/summary.json")
    assert len(find_photos([air], tmp_path).photos) == 5


def test_what_something_else_names_is_passed_over(air: Path, tmp_path: Path) -> None:
    ortho, walk = photo(air / "reference/ortho.tif", 9), photo(air / "walk/1.jpg").parent
    assert len(find_photos([air], tmp_path).photos) == 6
    assert len(find_photos([air], tmp_path, [ortho, walk]).photos) == 4


def test_links_to_folders_are_not_followed_and_told(air: Path, tmp_path: Path) -> None:
    outside = photo(tmp_path / "outside/a.jpg").parent
    (air / "circle").symlink_to(air, target_is_directory=True)
    (air / "out").symlink_to(outside, target_is_directory=True)
    found = find_photos([air], tmp_path)
    assert len(found.photos) == 4
    assert "links to folders are not followed" in found.notes[-1]
    assert str(air / "circle") in found.notes[-1] and str(air / "out") in found.notes[-1]
    # A source itself may be a link, and so may a photo.
    assert len(find_photos([air / "circle"], tmp_path).photos) == 4
    (air / "link.jpg").symlink_to(outside / "a.jpg")
    assert len(find_photos([air], tmp_path).photos) == 5


@pytest.mark.parametrize(
    ("suffix", "kind", "remedy"),
    [
        ("DNG", "raw photo", "develop to JPEG"),
        ("cr3", "raw photo", "develop to JPEG"),
        ("jp2", "JPEG 2000 image", "convert to JPEG"),
        ("jxl", "JPEG XL image", "convert to JPEG"),
        ("insp", "360 degree camera", "export flat photos"),
    ],
)
def test_what_cannot_be_read_is_told_by_name_number_and_remedy(
    suffix: str, kind: str, remedy: str, air: Path, tmp_path: Path
) -> None:
    for k in range(5):
        empty(air / f"100MEDIA/x{k}.{suffix}")
    found = find_photos([air], tmp_path)
    assert len(found.photos) == 4
    note = found.notes[-1]
    assert note.startswith("left out: 5 ") and kind in note and remedy in note
    assert f"air/100MEDIA/x0.{suffix}" in note and "..." in note and f"x4.{suffix}" not in note


def test_a_raw_beside_its_jpeg_and_a_clip_beside_its_photo_are_no_loss(air: Path, tmp_path: Path) -> None:
    empty(air / "100MEDIA/DJI_0001.DNG"), empty(air / "DJI_0003.MOV"), empty(air / "DJI_0009.dng")
    found = find_photos([air], tmp_path)
    assert found.videos == ()
    assert [note.split(",")[0] for note in found.notes[1:]] == [
        "left out: 1 raw photo (air/DJI_0009.dng)",
        "left out: 1 raw or other file (air/100MEDIA/DJI_0001.DNG) beside a photo of the same name",
        "left out: 1 short video (air/DJI_0003.MOV) beside a photo of the same name",
    ]


def test_nothing_left_is_an_error_that_says_what_was_there(tmp_path: Path) -> None:
    empty(tmp_path / "air/a.dng"), photo(tmp_path / "air/b.jpg"), photo(tmp_path / "air/c.jpg")
    with pytest.raises(InputError, match=r"air: has 2 images, at least 3 .*a\.dng.*develop to JPEG"):
        find_photos([tmp_path / "air"], tmp_path)
    for path in (tmp_path / "air").glob("*.jpg"):
        path.unlink()
    with pytest.raises(InputError, match=r"air: has no images.*a\.dng.*develop to JPEG"):
        find_photos([tmp_path / "air"], tmp_path)


def test_a_video_may_be_named_itself_and_a_photo_may_not(air: Path, tmp_path: Path) -> None:
    video = empty(tmp_path / "flight.MP4")
    found = find_photos([air, video], tmp_path)
    assert [(file.name, file.path) for file in found.videos] == [("flight.MP4", video)]
    assert [file.name for file in find_photos([video], tmp_path / "elsewhere").videos] == ["flight.MP4"]
    with pytest.raises(InputError, match=r"DJI_0003\.JPG: is a file; give the folder"):
        find_photos([air / "DJI_0003.JPG"], tmp_path)


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may read everything")
def test_a_sub_folder_that_may_not_be_read(air: Path, tmp_path: Path) -> None:
    (air / "100MEDIA").chmod(0)
    try:
        with pytest.raises(InputError, match="100MEDIA: cannot be read"):
            find_photos([air], tmp_path)
    finally:
        (air / "100MEDIA").chmod(0o755)


def test_threads_that_read_photos_keep_pillow_quiet_for_each_other() -> None:
    """The one that leaves first takes the filter of warnings away from nobody, and the last one leaves none behind."""
    before = list(warnings.filters)
    first, second = threading.Event(), threading.Event()

    def stays() -> None:
        with _QUIET_PILLOW:
            first.set()
            second.wait(10)

    thread = threading.Thread(target=stays)
    with _QUIET_PILLOW:
        thread.start()
        assert first.wait(10)
    try:
        warnings.warn_explicit("large", Image.DecompressionBombWarning, "x.py", 1, module="PIL.Image")
    finally:
        second.set()
        thread.join(10)
    assert list(warnings.filters) == before
