# SPDX-License-Identifier: Apache-2.0
"""Photos that are none, or that would harm: named in one line before any work."""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pillow_heif
import pytest
from PIL import Image

from skymoor.errors import InputError
from skymoor.store import open_photos
from support.tiny_site import Case, assert_refused, make_site, picture, write_raster

pillow_heif.register_heif_opener()


def bad(name: str, content: bytes) -> Callable[[Path], object]:
    """One more photo of this content."""
    return lambda site: (site / "airborne" / name).write_bytes(content)


def encoded(kind: str, pixels: np.ndarray | None = None, **options: object) -> bytes:
    buffer = BytesIO()
    Image.fromarray(picture() if pixels is None else pixels).save(buffer, kind, **options)  # type: ignore[arg-type]
    return buffer.getvalue()


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(width: int, height: int, *before: bytes, body: bytes = b"\0" * 100) -> bytes:
    """A PNG whose header says what it likes."""
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    rest = [chunk(b"IHDR", header), *before, chunk(b"IDAT", zlib.compress(body)), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(rest)


def jpeg_that_claims(width: int, height: int) -> bytes:
    whole = bytearray(encoded("JPEG"))
    start = whole.index(b"\xff\xc0") + 5
    whole[start : start + 4] = struct.pack(">HH", height, width)
    return bytes(whole)


def tiff_that_claims(width: int, height: int) -> bytes:
    whole = encoded("TIFF")
    for tag, old, new in ((256, 64, width), (257, 48, height)):
        entry = struct.pack("<HHI", tag, 4, 1)
        assert entry + struct.pack("<I", old) in whole
        whole = whole.replace(entry + struct.pack("<I", old), entry + struct.pack("<I", new))
    return whole


def bmp_that_claims(width: int, height: int) -> bytes:
    whole = bytearray(encoded("BMP"))
    whole[18:26] = struct.pack("<ii", width, height)
    return bytes(whole)


def zip_of_zeros() -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("photo.jpg", b"\0" * 10_000_000)
    return buffer.getvalue()


def dangling(site: Path) -> None:
    (site / "airborne/link.jpg").symlink_to(site / "nowhere.jpg")


def endless_link(site: Path) -> None:
    (site / "airborne/link.jpg").symlink_to("link.jpg")


def no_text(site: Path) -> None:
    name = os.fsencode(site / "airborne") + b"/\xff\xfe.png"
    Path(os.fsdecode(name)).write_bytes(encoded("PNG"))


def five_bands(site: Path) -> None:
    write_raster(site / "airborne/x.tif", np.full((5, 48, 64), 99, np.uint8))


def only(count: int) -> Callable[[Path], object]:
    return lambda site: [(site / f"airborne/{k}.png").unlink() for k in range(count, 4)] and None


TEXT_BOMB = chunk(b"zTXt", b"Comment\0\0" + zlib.compress(b"\0" * 20_000_000))
PROFILE_BOMB = chunk(b"iCCP", b"p\0\0" + zlib.compress(b"\0" * 20_000_000))

CASES = [
    Case("text named jpg", bad("x.jpg", b"hello"), ("x.jpg", "is not an image")),
    Case("nothing named jpg", bad("x.jpg", b""), ("x.jpg", "is not an image")),
    Case("zip named jpg", bad("x.jpg", zip_of_zeros()), ("x.jpg", "is not an image")),
    Case("gif named jpg", bad("x.jpg", encoded("GIF")), ("x.jpg", "is not an image", "convert")),
    Case("postscript named jpg", bad("x.jpg", encoded("EPS")), ("x.jpg", "is not an image")),
    Case("pdf named png", bad("x.png", b"%PDF-1.4\n"), ("x.png", "is not an image")),
    Case("svg named png", bad("x.png", b"<svg xmlns='http://www.w3.org/2000/svg'/>"), ("x.png", "is not an image")),
    Case("head of a jpeg", bad("x.jpg", encoded("JPEG")[:300]), ("x.jpg", "remove it or copy it again")),
    Case("jpeg without its end", bad("x.jpg", encoded("JPEG")[:-500]), ("x.jpg", "is damaged")),
    Case(
        "png with a flipped bit", bad("x.png", encoded("PNG")[:900] + b"?" + encoded("PNG")[901:]), ("x.png", "damaged")
    ),
    Case("png that claims 10 gigapixels", bad("x.png", png(100_000, 100_000)), ("x.png", "too large", "scale it down")),
    Case("png that claims 2^31", bad("x.png", png(2**31 - 1, 2**31 - 1)), ("x.png", "too large", "scale it down")),
    Case("jpeg that claims 4 gigapixels", bad("x.jpg", jpeg_that_claims(65_500, 65_500)), ("x.jpg", "too large")),
    Case("tiff that claims 10 gigapixels", bad("x.tif", tiff_that_claims(100_000, 100_000)), ("x.tif", "too large")),
    Case("bmp that claims 4 gigapixels", bad("x.bmp", bmp_that_claims(65_500, 65_500)), ("x.bmp", "too large")),
    Case("png that claims more than it holds", bad("x.png", png(9_000, 9_000)), ("x.png", "is damaged")),
    Case("png of 174 megapixels", bad("x.png", png(13_200, 13_200)), ("x.png", "13200 by 13200", "170 megapixels")),
    Case("png whose text explodes", bad("x.png", png(64, 48, TEXT_BOMB)), ("x.png", "copy it again")),
    Case(
        "png whose profile explodes", bad("x.png", png(64, 48, PROFILE_BOMB)), ("x.png", "remove it or copy it again")
    ),
    Case("png without a pixel", bad("x.png", png(0, 0)), ("x.png",)),
    Case("one pixel", bad("x.png", encoded("PNG", picture(0, 1, 1))), ("x.png", "only 1 by 1 pixels", "remove it")),
    Case("one pixel high", bad("x.png", encoded("PNG", picture(0, 5000, 1))), ("x.png", "only 5000 by 1 pixels")),
    Case("a strip", bad("x.png", encoded("PNG", picture(0, 2000, 40))), ("x.png", "2000 by 40", "20 times")),
    Case("floating-point pixels", bad("x.tif", encoded("TIFF", np.ones((48, 64), np.float32))), ("x.tif", "floating")),
    Case("five bands", five_bands, ("x.tif", "is not an image", "convert")),
    Case(
        "dng named tif", bad("x.tif", encoded("TIFF", tiffinfo={50706: b"\1\4\0\0"})), ("x.tif", "raw photo", "develop")
    ),
    Case("half of a heic", bad("x.heic", encoded("HEIF")[:-600]), ("x.heic", "copy it again")),
    Case("text named heic", bad("x.heic", b"hello"), ("x.heic", "is not an image")),
    Case("link to nothing", dangling, ("link.jpg", "link to nothing")),
    Case("link to itself", endless_link, ("link.jpg", "link to nothing")),
    Case("name of two lines", bad("a\nb.png", encoded("PNG")), (r"a\nb.png", "rename it")),
    Case("name that is not text", no_text, ("airborne", "rename it")),
    Case("no photo", only(0), ("airborne", "has no images", "sub-folders")),
    Case("two photos", only(2), ("airborne", "has 2 images, at least 3")),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_refused(case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert_refused(make_site(tmp_path), case, lambda: capsys.readouterr().err)


def test_a_ground_photo_is_refused_before_the_airborne_ones_are_reconstructed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site = make_site(tmp_path)
    (site / "ground").mkdir()
    for k in range(3):
        (site / f"ground/{k}.jpg").write_bytes(encoded("JPEG") if k else b"?")
    with (site / "site.toml").open("a") as file:
        file.write('[[ground]]\nimages = "ground"\n')
    assert_refused(site, Case("", lambda _: None, ("ground/0.jpg", "not an image")), lambda: capsys.readouterr().err)
    assert not list((site / "out/stages").glob("reconstruct*"))


@pytest.mark.parametrize("error", [PermissionError(13, "Permission denied"), OSError(5, "Input/output error")])
def test_a_photo_that_the_disk_refuses(
    error: OSError, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    site, real = make_site(tmp_path), Image.open

    def refuse(file: Path, **options: object) -> Image.Image:
        if file.name == "2.png":
            raise error
        return real(file, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Image, "open", refuse)
    case = Case("", lambda _: None, ("2.png", str(error.strerror)))
    assert_refused(site, case, lambda: capsys.readouterr().err)


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF", "BMP", "WEBP", "HEIF", "AVIF"])
def test_damage_anywhere_is_decoded_or_refused_by_name(kind: str, tmp_path: Path) -> None:
    rng, site = np.random.default_rng(1), make_site(tmp_path)
    whole, refused = encoded(kind), 0
    for k in range(120):
        spoilt = bytearray(whole)
        # Half of the damage in the first bytes, where the structure is.
        for place in rng.integers(0, len(whole) if k % 2 else 160, 3):
            spoilt[place] = rng.integers(256)
        (site / "airborne/x.png").write_bytes(spoilt)
        try:
            sizes = open_photos(site / "airborne", site).sizes
        except InputError as error:
            refused += 1
            assert "x.png" in str(error)
        else:
            assert len(sizes) == 5
    assert refused > 10
