# SPDX-License-Identifier: Apache-2.0
"""Which files belong to which set of a site, and where videos cannot be read."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from skymoor.errors import BackendUnavailable, InputError
from skymoor.pipeline import photo_sets
from skymoor.pipeline.photo_sets import find_sets, notes_of, or_too_few, require_distinct
from skymoor.pipeline.site import Site, site_from_arguments
from support.tiny_site import make_site, picture


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A site whose reference and ground photos lie among the airborne photos."""
    folder = make_site(tmp_path / "site")
    (folder / "walk").mkdir()
    for k in range(3):
        Image.fromarray(picture(9 + k)).save(folder / f"walk/{k}.png")
    return folder


def site_of(folder: Path, *airborne: Path, ground: tuple[Path, ...] = ()) -> Site:
    return site_from_arguments(airborne, ground, folder / "ortho.tif", folder / "dsm.tif", "ellipsoid", 2.0, 3.0)


def test_a_file_belongs_to_one_set(folder: Path) -> None:
    air, walk = find_sets(site_of(folder, folder, ground=(folder / "walk",)))
    assert [file.name for file in air.files.photos] == [f"site/airborne/{k}.png" for k in range(4)]
    assert [file.name for file in walk.files.photos] == [f"site/walk/{k}.png" for k in range(3)]
    (all_,) = find_sets(site_of(folder, folder))
    assert len(all_.files.photos) == 7  # the orthophoto and the DSM are none


def no_av(module: str, extra: str) -> None:
    raise BackendUnavailable(f'{module} cannot be imported: install it with pip install "skymoor[{extra}]"')


def test_without_pyav_videos_beside_photos_are_left_out_and_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(photo_sets, "video_ready", lambda: no_av("av", "video"))
    (folder / "airborne/flight.mp4").write_bytes(b"?")
    sets = find_sets(site_of(folder, folder / "airborne"))
    assert sets[0].files.videos == () and len(sets[0].files.photos) == 4
    (note,) = notes_of(sets)
    assert "1 video (airborne/flight.mp4)" in note and "skymoor[video]" in note
    # One that is named, or is all there is, is an error.
    with pytest.raises(BackendUnavailable, match=r"flight\.mp4: av cannot be imported.*skymoor\[video\]"):
        find_sets(site_of(folder, folder / "walk", folder / "airborne/flight.mp4"))
    for photo in (folder / "airborne").glob("*.png"):
        photo.unlink()
    with pytest.raises(BackendUnavailable, match=r"flight\.mp4"):
        find_sets(site_of(folder, folder / "airborne"))


def test_few_photos_are_named_as_the_reason() -> None:
    assert or_too_few("no surface", 8) == "no surface"
    told = or_too_few("no surface", 4)
    assert told.startswith("no surface: 4 photos are too few; give at least 8") and "70 %" in told


def test_two_folders_of_one_name_cannot_be_told_apart(folder: Path, tmp_path: Path) -> None:
    for owner in ("anna", "bert"):
        (tmp_path / owner / "photos").mkdir(parents=True)
    both = site_of(folder, tmp_path / "anna/photos", tmp_path / "bert/photos")
    require_distinct(both)  # their names begin with the owner
    twice = site_of(folder, folder / "airborne", ground=(folder / "airborne",))
    with pytest.raises(InputError, match="airborne: is named twice"):
        require_distinct(twice)
