# SPDX-License-Identifier: Apache-2.0
"""Photos that are odd but good: read with the right size, the right way round and in the right colours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pillow_heif
import pytest
from numpy.typing import NDArray
from PIL import Image

from skymoor.results.tables import read_cameras_csv
from skymoor.store import open_photos
from support.tiny_site import SITE, make_site, run

WIDTH_PX, HEIGHT_PX = 96, 64


def scene(width: int = WIDTH_PX, height: int = HEIGHT_PX) -> NDArray[np.uint8]:
    """Smooth colours that differ in every corner and channel: JPEG keeps them to a few levels."""
    x, y = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    return np.stack([40 + 180 * x, 200 - 150 * y, 60 + 120 * x * y], axis=-1).astype(np.uint8)


GREY = np.repeat(np.asarray(Image.fromarray(scene()).convert("L"))[..., None], 3, axis=2)
TURNED = np.rot90(scene(), -1)
Write = Callable[[Path], object]


def saved(name: str, mode: str = "RGB", pixels: NDArray[np.uint8] | None = None, **options: object) -> Write:
    def write(folder: Path) -> None:
        image = Image.fromarray(scene() if pixels is None else pixels).convert(mode)
        image.save(folder / name, options.pop("format", None), **options)  # type: ignore[arg-type]

    return write


def turned(orientation: int) -> Write:
    exif = Image.Exif()
    exif[0x0112] = orientation
    return saved("x.jpg", exif=exif)


def sixteen_bits(folder: Path) -> None:
    cv2.imwrite(str(folder / "x.png"), scene()[..., ::-1].astype(np.uint16) * 257)


def sixteen_bits_tiff(folder: Path) -> None:
    cv2.imwrite(str(folder / "x.tif"), scene()[..., ::-1].astype(np.uint16) * 257)


def two_pictures(folder: Path) -> None:
    """As the MPO files of some drones: a preview behind the photo."""
    Image.fromarray(scene()).save(
        folder / "x.jpg", "MPO", save_all=True, append_images=[Image.fromarray(scene()[::-1, ::-1].copy())]
    )


def named_mpo(folder: Path) -> None:
    two_pictures(folder)
    (folder / "x.jpg").rename(folder / "x.mpo")


def heic(name: str, **options: object) -> Write:
    def write(folder: Path) -> None:
        pillow_heif.from_pillow(Image.fromarray(scene())).save(folder / name, quality=95, **options)

    return write


def heic_with_orientation(folder: Path) -> None:
    """As phones write it: EXIF says how to turn, and so does the structure of the file, which the decoder obeys."""
    exif = Image.Exif()
    exif[0x0112] = 6
    image = pillow_heif.from_pillow(Image.fromarray(scene()))
    image.info["exif"] = exif.tobytes()
    image.save(folder / "x.heic", quality=95)


def pages(folder: Path) -> None:
    Image.fromarray(scene()).save(folder / "x.tif", save_all=True, append_images=[Image.fromarray(scene(20, 20))])


def through_a_link(folder: Path) -> None:
    saved("elsewhere.jpg")(folder.parent)
    (folder / "x.jpg").symlink_to(folder.parent / "elsewhere.jpg")


CASES: list[tuple[str, Write, str, NDArray[np.uint8]]] = [
    ("png named jpg", saved("x.jpg", format="PNG"), "x.jpg", scene()),
    ("jpeg named png", saved("x.png", format="JPEG"), "x.png", scene()),
    ("tiff named webp", saved("x.webp", format="TIFF"), "x.webp", scene()),
    ("ending in capitals", saved("x.JPEG", format="JPEG"), "x.JPEG", scene()),
    ("grey jpeg", saved("x.jpg", "L"), "x.jpg", GREY),
    ("grey png with alpha", saved("x.png", "LA"), "x.png", GREY),
    ("cmyk jpeg", saved("x.jpg", "CMYK"), "x.jpg", scene()),
    ("cmyk tiff", saved("x.tif", "CMYK"), "x.tif", scene()),
    ("ycbcr tiff", saved("x.tif", "YCbCr"), "x.tif", scene()),
    ("lab tiff", saved("x.tif", "LAB"), "x.tif", scene()),
    ("palette", saved("x.png", "P"), "x.png", scene()),
    ("progressive jpeg", saved("x.jpg", progressive=True), "x.jpg", scene()),
    ("16 bits per colour", sixteen_bits, "x.png", scene()),
    ("16 bits per colour tiff", sixteen_bits_tiff, "x.tif", scene()),
    ("portrait", saved("x.jpg", pixels=scene(HEIGHT_PX, WIDTH_PX)), "x.jpg", scene(HEIGHT_PX, WIDTH_PX)),
    *((f"exif orientation {k}", turned(k), "x.jpg", scene()) for k in (2, 3, 6, 8)),
    ("exif orientation of nonsense", turned(99), "x.jpg", scene()),
    ("two pictures in one jpeg", two_pictures, "x.jpg", scene()),
    ("two pictures named mpo", named_mpo, "x.mpo", scene()),
    ("heic", heic("x.HEIC"), "x.HEIC", scene()),
    ("heic named jpg", heic("x.jpg", format="HEIF"), "x.jpg", scene()),
    ("heic that is turned", heic_with_orientation, "x.heic", TURNED),
    ("avif", saved("x.avif", quality=95), "x.avif", scene()),
    ("pages", pages, "x.tif", scene()),
    ("link", through_a_link, "x.jpg", scene()),
    ("umlauts, spaces, commas", saved('Höhe 1, "süd".jpg'), 'Höhe 1, "süd".jpg', scene()),
    ("another script, and a face", saved("无人机 🛩️ 1%.jpg"), "无人机 🛩️ 1%.jpg", scene()),
    ("decomposed accents", saved("e\u0301te\u0301.jpg"), "e\u0301te\u0301.jpg", scene()),
    ("brackets as in markup", saved("[bold]x[].jpg"), "[bold]x[].jpg", scene()),
]


@pytest.mark.parametrize(("write", "name", "expected"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_accepted(write: Write, name: str, expected: NDArray[np.uint8], tmp_path: Path) -> None:
    folder = make_site(tmp_path) / "airborne"
    write(folder)
    photos = open_photos(folder, tmp_path)
    index = photos.names.index(f"airborne/{name}")
    read = photos.read(photos.names[index])
    assert photos.sizes[index] == (expected.shape[1], expected.shape[0]) == (read.shape[1], read.shape[0])
    assert read.dtype == np.uint8 and read.shape[2] == 3
    # JPEG and colour spaces cost a few levels; a palette of the web has steps of 51, and right means.
    if len(np.unique(read)) > 6:
        assert np.abs(read.astype(int) - expected).mean() < 3
    assert np.abs(read.mean(axis=(0, 1)) - expected.mean(axis=(0, 1))).max() < 6


def test_odd_names_come_back_from_the_tables(tmp_path: Path) -> None:
    site = make_site(tmp_path / "ünï [code] 1" / "site of, mine")
    (site / "airborne").rename(site / "фото 1")
    (site / "site.toml").write_text(SITE.replace('"airborne"', '"фото 1"'), encoding="utf-8")
    names = ['a, "b".png', "ü [x].png", "日本.png", " c.png"]
    for k, name in enumerate(names):
        (site / f"фото 1/{k}.png").rename(site / "фото 1" / name)
    assert run(site, out="er gebnis") == 3
    rows = read_cameras_csv(site / "er gebnis/cameras.csv")
    assert sorted(row.image for row in rows) == sorted(f"фото 1/{name}" for name in names)


def test_what_is_no_photo_is_passed_over(tmp_path: Path) -> None:
    import os

    site = make_site(tmp_path)
    (site / "airborne/folder.jpg").mkdir()
    os.mkfifo(site / "airborne/pipe.jpg")  # opening it would wait for ever
    (site / "airborne/.hidden.jpg").write_text("?")
    (site / "airborne/Thumbs.db").write_text("?")
    assert len(open_photos(site / "airborne", site)) == 4


def test_mixed_sizes_keep_each_its_own(tmp_path: Path) -> None:
    site = make_site(tmp_path)
    sizes = {"p.jpg": (40, 70), "q.jpg": (70, 40), "r.jpg": (200, 100)}
    for name, (width, height) in sizes.items():
        saved(name, pixels=scene(width, height))(site / "airborne")
    photos = open_photos(site / "airborne", site)
    found = dict(zip(photos.names, photos.sizes, strict=True))
    assert {name: found[f"airborne/{name}"] for name in sizes} == sizes
    assert run(site) == 3
    assert len(read_cameras_csv(site / "out/cameras.csv")) == 7
