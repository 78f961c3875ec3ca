# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from skymoor.errors import InputError
from skymoor.store import Store, digest, find_photos, has_metadata, open_photos

RGB: NDArray[np.uint8] = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three PNG photos and things that are no photos."""
    folder = tmp_path / "site" / "airborne"
    (folder / ".thumbnails").mkdir(parents=True)
    for name in ("c.png", "a.PNG", "b.png"):
        save(folder / name)
    save(folder / ".hidden.png")
    save(folder / ".thumbnails" / "d.png")
    (folder / "notes.txt").write_text("x")
    return folder


def save(path: Path, **options: object) -> None:
    Image.fromarray(RGB).save(path, **options)  # type: ignore[arg-type]


def test_names_sizes_and_pixels(folder: Path) -> None:
    steps: list[tuple[int, int]] = []
    photos = open_photos(folder, folder.parent, lambda done, total: steps.append((done, total)))
    assert photos.names == ("airborne/a.PNG", "airborne/b.png", "airborne/c.png")
    assert photos.sizes == ((60, 40),) * 3
    assert steps == [(0, 3), (1, 3), (2, 3), (3, 3)]
    np.testing.assert_array_equal(photos.read("airborne/b.png"), RGB)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(photos)).read("airborne/b.png"), RGB)


def test_names_of_a_folder_elsewhere(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert open_photos(folder, tmp_path / "other").names[0] == "airborne/a.PNG"
    monkeypatch.chdir(folder)
    assert open_photos(Path(), Path("..")).names[0] == "airborne/a.PNG"
    assert open_photos(Path(), Path()).names[0] == "a.PNG"


def test_orientation_is_ignored(folder: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90 degrees
    save(folder / "d.png", exif=exif)
    photos = open_photos(folder, folder)
    assert photos.sizes[-1] == (60, 40)
    np.testing.assert_array_equal(photos.read("d.png"), RGB)


@pytest.mark.parametrize("mode", ["L", "LA", "RGBA", "P", "1", "CMYK"])
def test_every_mode_becomes_rgb(folder: Path, mode: str) -> None:
    suffix = "tif" if mode == "CMYK" else "png"
    expected = Image.fromarray(RGB).convert(mode)
    expected.save(folder / f"d.{suffix}")
    read = open_photos(folder, folder).read(f"d.{suffix}")
    assert (read.shape, read.dtype) == (RGB.shape, np.uint8)
    np.testing.assert_array_equal(read, np.asarray(expected.convert("RGB")))


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_16_bits_become_8(folder: Path, suffix: str) -> None:
    deep = np.linspace(0, 65535, 2400).astype(np.uint16).reshape(40, 60)
    Image.fromarray(deep).save(folder / f"d.{suffix}")
    read = open_photos(folder, folder).read(f"d.{suffix}")
    np.testing.assert_array_equal(read, np.repeat((deep // 256).astype(np.uint8)[..., None], 3, axis=2))


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp", "bmp"])
def test_truncated_photo_is_named(folder: Path, suffix: str) -> None:
    path = folder / f"broken.{suffix}"
    save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.raises(InputError, match=rf"broken\.{suffix}: is .*(remove|copy)"):
        open_photos(folder, folder)


def test_other_unusable_photos_are_named(folder: Path) -> None:
    (folder / "z.jpg").write_bytes(b"not a photo")
    with pytest.raises(InputError, match=r"z\.jpg: is not an image"):
        open_photos(folder, folder)
    (folder / "z.jpg").unlink()
    Image.fromarray(np.zeros((4, 4), np.float32)).save(folder / "y.tif")
    with pytest.raises(InputError, match=r"y\.tif: has floating-point"):
        open_photos(folder, folder)


def test_missing_empty_and_small_folders(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        open_photos(tmp_path / "none", tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="has no images, also not in sub-folders"):
        open_photos(tmp_path / "empty", tmp_path)
    (folder / "a.PNG").unlink()
    with pytest.raises(InputError, match="has 2 images, at least 3"):
        open_photos(folder, folder)


def test_photos_count_by_names_and_content(folder: Path, tmp_path: Path) -> None:
    def key(at: Path) -> str:
        with Store.open(tmp_path / "out") as store:
            return digest(store.photos("photos", find_photos([at], at.parent)))

    before = key(folder)
    (folder / "notes.txt").write_text("y")
    os.utime(folder / "b.png", ns=(0, 1))
    assert key(folder) == before
    copied = Path(shutil.copytree(folder, tmp_path / "elsewhere" / folder.name))
    assert key(copied) == before
    (copied / "b.png").rename(copied / "d.png")
    renamed = key(copied)
    Image.fromarray(RGB[::-1]).save(copied / "d.png")
    assert len({before, renamed, key(copied)}) == 3


def test_check_is_not_repeated_when_resuming(folder: Path, tmp_path: Path) -> None:
    for cached in (False, True):
        with Store.open(tmp_path / "out") as store:
            photos = store.photos("photos-air", find_photos([folder], folder.parent))
            assert store.records[0].cached is cached
        np.testing.assert_array_equal(photos.read("airborne/a.PNG"), RGB)
    save(folder / "d.png")
    with Store.open(tmp_path / "out") as store:
        assert len(store.photos("photos-air", find_photos([folder], folder.parent))) == 4
        assert not store.records[0].cached


def metadata_in(folder: Path) -> int:
    return has_metadata(find_photos([folder], folder).photos)


def test_metadata_is_counted(folder: Path) -> None:
    assert metadata_in(folder) == 0
    position, focal, orientation = Image.Exif(), Image.Exif(), Image.Exif()
    position.get_ifd(0x8825)[1] = "N"
    focal.get_ifd(0x8769)[0x920A] = 8.8
    orientation[0x0112] = 1
    for name, exif in (("p.jpg", position), ("f.jpg", focal), ("o.jpg", orientation)):
        save(folder / name, exif=exif)
    save(folder / "x.jpg", xmp=b"<x:xmpmeta/>")
    (folder / "z.jpg").write_bytes(b"not a photo")
    assert metadata_in(folder) == 3
