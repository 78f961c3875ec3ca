# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skymoor.errors import InputError
from skymoor.geo import UNKNOWN_HEIGHT_SIGMA_M, ce90_m, le90_m
from skymoor.pipeline.site import load_site, site_from_arguments
from support.map_scene import write_dsm

GOOD = """
name = "office park"
[reference]
ortho = "reference/ortho.tif"
dsm = "reference/dsm.tif"
vertical_datum = "EPSG:3855"
covariance = [[1.7, 0.1, 0], [0.1, 1.6, 0], [0, 0, 5.4]]
[airborne]
images = "airborne"
[[ground]]
images = "walk 1"
[[ground]]
images = "walk 2"
[options]
"match.cycle_px" = 3
[options.model]
pixel_m = 0.2
"""


STATED = "covariance = [[1.7, 0.1, 0], [0.1, 1.6, 0], [0, 0, 5.4]]"


@pytest.fixture
def site(tmp_path: Path) -> Path:
    for folder in ("airborne", "walk 1", "walk 2", "reference"):
        (tmp_path / folder).mkdir()
    for name in ("ortho.tif", "dsm.tif"):
        (tmp_path / "reference" / name).touch()
    (tmp_path / "site.toml").write_text(GOOD)
    return tmp_path / "site.toml"


def change(site: Path, old: str, new: str) -> Path:
    text = site.read_text()
    assert old in text
    site.write_text(text.replace(old, new, 1))
    return site


def test_reads_everything_relative_to_its_folder(site: Path) -> None:
    loaded = load_site(site)
    root = site.parent.resolve()
    assert (loaded.name, loaded.root) == ("office park", root)
    assert loaded.reference.ortho == root / "reference/ortho.tif"
    assert loaded.reference.dsm == root / "reference/dsm.tif"
    assert loaded.reference.vertical_datum == "EPSG:3855"
    np.testing.assert_array_equal(loaded.reference.covariance, [[1.7, 0.1, 0], [0.1, 1.6, 0], [0, 0, 5.4]])
    assert loaded.airborne == (root / "airborne",)
    assert loaded.ground == ((root / "walk 1",), (root / "walk 2",))
    assert loaded.options == {"match.cycle_px": 3, "model": {"pixel_m": 0.2}}


def test_a_set_may_have_several_folders_and_videos(site: Path) -> None:
    (site.parent / "flight.mp4").touch()
    change(site, 'images = "airborne"', 'images = ["airborne", "flight.mp4"]')
    change(site, 'images = "walk 1"', 'images = ["walk 1"]')
    loaded, root = load_site(site), site.parent.resolve()
    assert loaded.airborne == (root / "airborne", root / "flight.mp4")
    assert loaded.sets == [
        ("airborne", loaded.airborne),
        ("ground0", (root / "walk 1",)),
        ("ground1", (root / "walk 2",)),
    ]


def test_ground_photos_alone_are_a_site(site: Path) -> None:
    change(site, '[airborne]\nimages = "airborne"', "")
    assert [name for name, _ in load_site(site).sets] == ["ground0", "ground1"]


def test_ce90_le90_become_the_covariance_with_these_figures(site: Path) -> None:
    change(site, STATED, "ce90 = 2\nle90 = 3.8")
    covariance = load_site(site).reference.covariance
    assert ce90_m(covariance) == pytest.approx(2.0)
    assert le90_m(covariance) == pytest.approx(3.8)


def test_command_line_overrules_the_file(site: Path) -> None:
    loaded = load_site(site, vertical_datum="ellipsoid", ce90=5.0, le90=6.0)
    assert loaded.reference.vertical_datum == "ellipsoid"
    assert ce90_m(loaded.reference.covariance) == pytest.approx(5.0)


def test_one_height_in_place_of_a_dsm(site: Path) -> None:
    for written, height in (("120", 120.0), ("-3.5", -3.5), ("0", 0.0)):
        change(site, '"reference/dsm.tif"', written)
        assert load_site(site).reference.dsm == height
        change(site, f"dsm = {written}\n", 'dsm = "reference/dsm.tif"\n')
    change(site, '"reference/dsm.tif"', "120.0")
    change(site, STATED, "ce90 = 2")
    with pytest.raises(InputError, match="le90 missing"):
        load_site(site)


def test_without_a_dsm_neither_datum_nor_le90_are_needed(site: Path) -> None:
    change(site, 'dsm = "reference/dsm.tif"', "")
    assert load_site(site).reference.vertical_datum == "EPSG:3855"  # it is not used
    change(site, 'vertical_datum = "EPSG:3855"', "")
    change(site, STATED, "ce90 = 2")
    loaded = load_site(site)
    assert loaded.reference.dsm is None and loaded.reference.vertical_datum is None
    assert ce90_m(loaded.reference.covariance) == pytest.approx(2.0)
    assert np.sqrt(loaded.reference.covariance[2, 2]) == pytest.approx(UNKNOWN_HEIGHT_SIGMA_M)
    change(site, "ce90 = 2", "le90 = 2")
    with pytest.raises(InputError, match="ce90 missing"):
        load_site(site)


def test_datum_and_name_may_be_missing(site: Path) -> None:
    change(site, 'name = "office park"', "")
    change(site, 'vertical_datum = "EPSG:3855"', "")
    loaded = load_site(site)
    assert loaded.name == site.parent.name
    assert loaded.reference.vertical_datum is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("vertical_datum", "vertical_datun", r"vertical_datun in \[reference\]; did you mean vertical_datum"),
        ("[airborne]", "[airbourne]", "airbourne; did you mean airborne"),
        ('images = "walk 1"', 'image = "walk 1"', r"image in \[ground\]; did you mean images"),
        ('[[ground]]\nimages = "walk 1"\n[[ground]]', "[ground]", "double brackets"),
        ('"reference/dsm.tif"', '"reference/none.tif"', r"reference\.dsm: there is no file .*none\.tif"),
        ('ortho = "reference/ortho.tif"', "", r"ortho is missing in \[reference\]"),
        ('dsm = "reference/dsm.tif"', 'dms = "reference/dsm.tif"', r"dms in \[reference\]; did you mean dsm"),
        ('"reference/dsm.tif"', "true", r"reference\.dsm = True must be a file in quotes, or a height in metres"),
        ('"reference/dsm.tif"', "[3]", r"reference\.dsm = \[3\] must be a file in quotes, or a height in metres"),
        ('"reference/dsm.tif"', "inf", r"reference\.dsm = inf must be a height in metres"),
        ('images = "airborne"', 'images = "air"', r"airborne\.images: there is no folder"),
        ('images = "airborne"', "images = []", r"airborne\.images = \[\] must be text in quotes"),
        ('images = "airborne"', 'images = ["airborne", 3]', r"airborne\.images = 3 must be text in quotes"),
        ('images = "airborne"', 'images = ["airborne", "b"]', r"airborne\.images: there is no folder .*b, nor video"),
        ('images = "airborne"', "", r"images is missing in \[airborne\]"),
        ("[0.1, 1.6, 0]", "[0.2, 1.6, 0]", "symmetric"),
        ("[0.1, 1.6, 0]", "[0.1, -1.6, 0]", "positive"),
        ("[0.1, 1.6, 0], ", "", "covariance must be 3 rows"),
        ("[0.1, 1.6, 0]", '"x"', "covariance must be 3 rows"),
        ("covariance = ", "ce90 = 3\ncovariance = ", "keep one of them"),
        (STATED, "", "accuracy of the reference is not stated"),
        (STATED, "ce90 = 3", "le90 missing"),
        (STATED, "ce90 = 0\nle90 = 3", "above zero"),
        (STATED, "ce90 = true\nle90 = 3", "number of metres"),
        ('name = "office park"', "name = office", "not valid TOML"),
        ("[options]", "[options]\n[options]", "not valid TOML"),
    ],
)
def test_every_mistake_is_one_clear_line(site: Path, old: str, new: str, message: str) -> None:
    change(site, old, new)
    with pytest.raises(InputError, match=message) as caught:
        load_site(site)
    assert "\n" not in str(caught.value)
    assert str(site) in str(caught.value)


def test_missing_reference_and_images(site: Path) -> None:
    site.write_text("[airborne]\nimages = 'airborne'\n")
    with pytest.raises(InputError, match=r"\[reference\] is missing"):
        load_site(site)
    site.write_text(GOOD.partition("[airborne]")[0])
    with pytest.raises(InputError, match="there are no images"):
        load_site(site)


def test_no_file_folder_and_not_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_site(tmp_path / "none.toml")
    with pytest.raises(InputError, match="is a folder"):
        load_site(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not valid TOML"):
        load_site(tmp_path / "binary.toml")


def test_site_from_arguments(site: Path) -> None:
    root = site.parent
    ortho, dsm = root / "reference/ortho.tif", root / "reference/dsm.tif"
    made = site_from_arguments([root / "airborne"], [root / "walk 1"], ortho, dsm, "ellipsoid", 2.0, 3.0)
    assert made.root == root.resolve()
    assert made.airborne == (root / "airborne",)
    assert made.ground == ((root / "walk 1",),)
    assert le90_m(made.reference.covariance) == pytest.approx(3.0)
    assert site_from_arguments([root / "airborne"], [], ortho, 120.0, "ellipsoid", 2.0, 3.0).reference.dsm == 120.0
    assert site_from_arguments([root / "airborne"], [], ortho, None, None, 2.0, None).reference.dsm is None


def test_several_airborne_folders_are_one_set_and_several_ground_folders_are_not(site: Path) -> None:
    walks, ortho = [site.parent / "walk 1", site.parent / "walk 2"], site.parent / "reference/ortho.tif"
    assert site_from_arguments(walks, [], ortho, None, None, 2.0, None).sets == [("airborne", tuple(walks))]
    assert site_from_arguments([], walks, ortho, None, None, 2.0, None).sets == [
        ("ground0", (walks[0],)),
        ("ground1", (walks[1],)),
    ]


def test_site_from_arguments_mistakes(site: Path) -> None:
    root = site.parent
    ortho, dsm = root / "reference/ortho.tif", root / "reference/dsm.tif"
    with pytest.raises(InputError, match=r"--dsm .*none\.tif"):
        site_from_arguments([root / "airborne"], [], ortho, root / "none.tif", None, 2.0, 3.0)
    with pytest.raises(InputError, match="--dsm nan: give a file, or the height"):
        site_from_arguments([root / "airborne"], [], ortho, float("nan"), None, 2.0, 3.0)
    with pytest.raises(InputError, match="no such folder"):
        site_from_arguments([root / "air"], [], ortho, dsm, None, 2.0, 3.0)
    with pytest.raises(InputError, match="no images"):
        site_from_arguments([], [], ortho, dsm, None, 2.0, 3.0)
    with pytest.raises(InputError, match="--ce90"):
        site_from_arguments([root / "airborne"], [], ortho, dsm, None, None, None)


def test_an_unknown_accuracy_is_a_statement(site: Path) -> None:
    change(site, STATED, 'accuracy = "unknown"')
    assert np.isnan(load_site(site).reference.covariance).all()
    assert ce90_m(load_site(site, ce90=5.0, le90=6.0).reference.covariance) == pytest.approx(5.0)  # overruled
    change(site, 'accuracy = "unknown"', 'accuracy = "unknown"\nce90 = 3')
    with pytest.raises(InputError, match="accuracy and ce90/le90; keep one"):
        load_site(site)
    assert np.isnan(load_site(site, accuracy="unknown").reference.covariance).all()
    with pytest.raises(InputError, match="--accuracy unknown says that nobody knows"):
        load_site(site, accuracy="unknown", ce90=2.0)
    change(site, 'accuracy = "unknown"\nce90 = 3', 'accuracy = "good"')
    with pytest.raises(InputError, match='the only word for it is "unknown"'):
        load_site(site)


def test_all_that_is_missing_is_told_at_once_with_usual_values(site: Path) -> None:
    change(site, STATED, "")
    with pytest.raises(InputError, match=r"ce90 and le90 missing") as error:
        load_site(site)
    assert any("Copernicus" in line for line in error.value.details)
    text = site.read_text()
    site.write_text("\n".join(line for line in text.splitlines() if not line.startswith("vertical_datum")))
    write_dsm(site.parent / "reference")  # whose CRS says nothing of heights
    with pytest.raises(InputError, match=r"ce90 and le90 and vertical_datum missing") as error:
        load_site(site)
    assert 'accuracy = "unknown"' in str(error.value) and "\n" not in str(error.value)


def test_rights_of_a_fetched_reference_are_found_beside_it(site: Path) -> None:
    folder = site.parent
    fetched = '[reference]\northo = "ortho.tif"\nlicence = "CC-BY-4.0"\ncredit = "Survey"\nce90 = 1.0\nle90 = 1.0\n'
    (folder / "reference/reference.toml").write_text(fetched)
    ortho, arguments = folder / "reference/ortho.tif", (None, "ellipsoid", 5.0, 6.0)
    files = site_from_arguments([folder / "airborne"], [], ortho, *arguments).reference
    assert (files.licence, files.credit, files.date) == ("CC-BY-4.0", "Survey", None)
    assert ce90_m(files.covariance) == pytest.approx(5.0)  # nothing else is taken from there
    for other in (fetched.replace("ortho.tif", "other.tif"), "not TOML ["):
        (folder / "reference/reference.toml").write_text(other)
        assert site_from_arguments([folder / "airborne"], [], ortho, *arguments).reference.licence is None
