# SPDX-License-Identifier: Apache-2.0
"""A drafted site.toml says what is there and asks for what is not; it is never written over another."""

from __future__ import annotations

from pathlib import Path

import pytest
import rasterio
from PIL import Image

from skymoor.cli.main import main
from skymoor.errors import InputError
from skymoor.pipeline.site import load_site
from support.tiny_site import content, make_site, picture


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Photos in sub-folders, one that is raw, ground photos, and a reference, without a site.toml."""
    site = make_site(tmp_path / "site")
    (site / "site.toml").unlink()
    (site / "airborne/100MEDIA").mkdir()
    Image.fromarray(picture(9, 80, 60)).save(site / "airborne/100MEDIA/a.png")
    (site / "airborne/b.dng").write_bytes(b"?")
    (site / "walk").mkdir()
    for k in range(3):
        Image.fromarray(picture(k)).save(site / f"walk/{k}.png")
    return site


def init(data: Path, *more: str) -> int:
    reference = ("--ortho", str(data / "ortho.tif"), "--dsm", str(data / "dsm.tif"))
    photos = (str(data / "airborne"), "--ground", str(data / "walk"))
    return main(["init", *photos, *reference, "--out", str(data), *more])


def test_what_is_found_is_told_and_what_is_missing_is_to_do(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert init(data) == 0
    shown, text = capsys.readouterr().out, (data / "site.toml").read_text()
    for words in ("5 photos, 64 by 48 (4) and 80 by 60 (1)", "100MEDIA (1)", "left out: 1 raw photo", "EPSG:32617"):
        assert words in shown and words in text
    assert "40 m by 40 m" in text and "80 by 80 pixels of 0.5 m" in text and 'images = "walk"' in text
    assert "marked TO DO: vertical_datum, ce90, le90" in shown and "--dry-run" in shown
    assert '# accuracy = "unknown"' in text and "Copernicus" in text
    with pytest.raises(InputError, match="ce90 and le90 and vertical_datum missing"):
        load_site(data / "site.toml")
    completed = text.replace('# accuracy = "unknown"', 'accuracy = "unknown"')
    (data / "site.toml").write_text(completed.replace('# vertical_datum = "ellipsoid"', 'vertical_datum = "ellipsoid"'))
    loaded = load_site(data / "site.toml")
    assert loaded.sets == [("airborne", (data / "airborne",)), ("ground0", (data / "walk",))]


def test_with_all_that_is_needed_it_can_be_run_at_once(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert init(data, "--vertical-datum", "ellipsoid", "--ce90", "2", "--le90", "3.5") == 0
    assert "# TO DO" not in (data / "site.toml").read_text()
    assert load_site(data / "site.toml").reference.vertical_datum == "ellipsoid"
    assert main(["run", str(data), "--out", str(data / "out"), "--dry-run"]) == 0


def test_a_datum_that_the_file_states_is_not_asked_for(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with rasterio.open(data / "dsm.tif", "r+") as raster:
        raster.crs = rasterio.CRS.from_user_input("EPSG:32617+5703")
    assert init(data) == 0
    assert "vertical datum: the DSM states EPSG:5703" in capsys.readouterr().out
    assert "TO DO: the vertical datum" not in (data / "site.toml").read_text()


def test_without_a_reference_it_says_how_to_get_one(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", str(data / "airborne"), "--out", str(data / "new.toml")]) == 0
    assert "marked TO DO: ortho, ce90" in capsys.readouterr().out
    text = (data / "new.toml").read_text()
    assert "skymoor reference --bbox" in text and "# dsm = 412.0" in text and "le90 =" not in text


def test_an_address_and_a_height_are_written_as_they_are(data: Path) -> None:
    arguments = ["init", str(data / "airborne"), "--ortho", "https://x.example/o.tif", "--dsm", "41", "--accuracy"]
    assert main([*arguments, "unknown", "--out", str(data)]) == 0
    text = (data / "site.toml").read_text()
    assert 'ortho = "https://x.example/o.tif"' in text and "dsm = 41.0" in text and '\naccuracy = "unknown"' in text


@pytest.mark.parametrize("kind", ["there", "photos", "none", "raster", "apart"])
def test_what_is_wrong_is_one_line_and_nothing_is_written(
    kind: str, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more: list[str] = []
    if kind == "there":
        (data / "site.toml").write_text("mine")
    elif kind == "photos":
        more = [str(data / "nothing")]
    elif kind == "raster":
        (data / "dsm.tif").write_bytes(b"?")
    elif kind == "apart":
        with rasterio.open(data / "dsm.tif", "r+") as raster:
            raster.transform = rasterio.Affine(0.5, 0, 600_000, 0, -0.5, 3_000_000)
    before = content(data)
    if kind == "none":
        assert main(["init", "--out", str(data)]) == 2
    else:
        assert init(data, *more) == 2
    (line,) = capsys.readouterr().err.splitlines()
    words = {"there": "not overwritten", "photos": "nothing", "none": "no images", "raster": "dsm.tif"}
    assert words.get(kind, "do not overlap") in line
    assert content(data) == before
