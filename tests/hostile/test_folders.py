# SPDX-License-Identifier: Apache-2.0
"""Command lines and folders that would do harm, and site files that say something impossible."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from skymoor.cli.main import main
from skymoor.store import PhotoFile, Store, _run, check_photos
from support.tiny_site import SITE, Case, assert_refused, content, make_site, run


def arguments(*more: str) -> Callable[[Path], tuple[str, ...]]:
    return lambda site: more


def out(name: str) -> Callable[[Path], tuple[str, ...]]:
    return lambda site: ("--out", str(site / name))


def toml(old: str, new: str) -> Callable[[Path], None]:
    def write(site: Path) -> None:
        assert old in SITE
        (site / "site.toml").write_text(SITE.replace(old, new), encoding="utf-8")

    return write


def more_toml(text: str) -> Callable[[Path], None]:
    return lambda site: (site / "site.toml").write_text(SITE + text, encoding="utf-8") and None


def in_products(site: Path) -> tuple[str, ...]:
    """The photos lie where pictures of renders would be written."""
    (site / "airborne").rename(site / "renders")
    (site / "ref").mkdir()
    for name in ("ortho.tif", "dsm.tif"):
        (site / name).rename(site / "ref" / name)
    moved = (
        SITE.replace('"airborne"', '"renders"').replace("ortho.tif", "ref/ortho.tif").replace("dsm.tif", "ref/dsm.tif")
    )
    (site / "site.toml").write_text(moved)
    return out(".")(site)


def another_project(site: Path) -> tuple[str, ...]:
    (site / "mine").mkdir()
    (site / "mine/dsm.tif").write_text("a week of work")
    return out("mine")(site)


def same_names(site: Path) -> tuple[str, ...]:
    """Two folders of one name, neither in the site's folder: their photos could not be told apart."""
    for owner in ("anna", "bert"):
        shutil.copytree(site / "airborne", site.parent / f"{site.name} {owner}/photos")
    folders = [site.parent / f"{site.name} {owner}/photos" for owner in ("anna", "bert")]
    (site / "site.toml").write_text(
        SITE.replace('"airborne"', f'"{folders[0]}"') + f'[[ground]]\nimages="{folders[1]}"\n'
    )
    return ()


LONG = "x" * 5000
CASES = [
    Case("out is the photos", out("airborne"), ("airborne", "another folder with --out")),
    Case("out holds the reference", out("."), ("ortho.tif", "another folder with --out")),
    Case("out holds the photos", in_products, ("renders", "another folder with --out")),
    Case("out holds another's dsm", another_project, ("mine/dsm.tif", "another folder with --out")),
    Case("out is a file", out("site.toml"), ("site.toml", "is a file")),
    Case("out is below a file", out("site.toml/out"), ("site.toml", "cannot be written")),
    Case("out has a name that is too long", out(LONG), ("cannot be written", "name too long")),
    Case("seed below zero", arguments("--seed", "-1"), ("--seed -1", "from 0 to")),
    Case("seed too large", arguments("--seed", str(2**31)), ("--seed 2147483648",)),
    Case(
        "option of nonsense", arguments("--set", "match.candidates=" + "[" * 3000), ("match.candidates", "whole number")
    ),
    Case("option without a value", arguments("--set", "match.candidates"), ("NAME=VALUE",)),
    Case("one folder twice", more_toml('[[ground]]\nimages = "airborne"\n'), ("airborne", "named twice")),
    Case("two folders of one name", same_names, ("photos", "name each folder of photos once")),
    Case("two tables", more_toml("[reference]\n"), ("site.toml", "not valid TOML")),
    Case("brackets without end", more_toml("[options]\na = " + "[" * 5000), ("site.toml", "not valid TOML")),
    Case("a number of 5000 digits", toml("2.5", "1" * 5000), ("site.toml", "not valid TOML")),
    Case("a number beyond all numbers", toml("2.5", "1" + "0" * 400), ("site.toml", "reference.ce90")),
    Case("accuracy of nan", toml("2.5", "nan"), ("site.toml", "ce90")),
    Case("accuracy of inf", toml("3.8", "inf"), ("site.toml", "le90")),
    Case("accuracy as text", toml("2.5", '"2.5"'), ("site.toml", "must be a number")),
    Case("a key of two lines", more_toml('"a\\nb" = 1\n'), ("site.toml", r"a\nb")),
    Case("a path of zeros", toml('"ortho.tif"', '"a\\u0000b"'), ("site.toml", r"a\x00b")),
    Case("a path too long", toml('"ortho.tif"', f'"{LONG}"'), ("site.toml", "no file")),
    Case("no photos", toml('[airborne]\nimages = "airborne"', ""), ("site.toml", "there are no images")),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_refused(case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert_refused(make_site(tmp_path / "site"), case, lambda: capsys.readouterr().err)


def test_a_second_run_in_one_folder_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    with Store.open(site / "out"):
        before = content(site)
        assert run(site) == 2
        assert content(site) == before
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and "another run is writing here" in lines[0] and "--out" in lines[0]
    assert run(site) == 3


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["simulate", "--out", "x" * 300], "File name too long"),
        (["simulate", "--out", "file"], "file"),
        (["simulate", "--out", "file/below"], "Not a directory"),
        (["demo", "--out", "file"], "file"),
        (["evaluate", "file", "--truth", "file"], "file: there is no such folder"),
        (["evaluate", "x" * 300, "--truth", "file"], "there is no such folder"),
        (["run", "file", "--out", "out"], "not valid TOML"),
        (["run", "--airborne", "x" * 300, "--ortho", "file", "--dsm", "file", "--out", "out"], "no such folder"),
        (["run", "--ortho", "file", "--dsm", "file", "--out", "out"], "there are no images"),
        (["run", "--airborne", ".", "--out", "out"], "--ortho"),
        (["run", "--airborne", ".", "--ortho", "file", "--dsm", "file", "--out", "out"], "--ce90"),
        (["weights", "fetch", "nothing"], "nothing"),
    ],
)
def test_commands_on_paths_that_are_none(
    words: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("?")
    assert main(words) == 2
    first, *more = capsys.readouterr().err.splitlines()
    assert told in first
    assert all(line.startswith(("usual values", "  ")) for line in more)  # a table to choose the accuracy from
    assert bool(more) == (told == "--ce90")
    assert content(tmp_path) == {"file": b"?"}


def test_names_that_look_like_markup(tmp_path: Path) -> None:
    site = make_site(tmp_path / "[/bold]")
    (site / "site.toml").write_text('name = "[/x] [red]"\n' + SITE)
    assert run(site, out="[out]") == 3


def test_a_byte_order_mark(tmp_path: Path) -> None:
    site = make_site(tmp_path)
    (site / "site.toml").write_bytes(b"\xef\xbb\xbf" + SITE.replace("\n", "\r\n").encode())
    assert run(site) == 3


def test_the_folder_of_a_former_run_is_used_again(tmp_path: Path) -> None:
    """Also without the cache, and without the hidden lock, which copying may lose."""
    site = make_site(tmp_path)
    assert run(site) == 3
    shutil.rmtree(site / "out/stages")
    (site / "out/.lock").unlink()
    assert run(site) == 3
    assert (site / "out/cameras.csv").exists()


def check_and_lose(files: Sequence[PhotoFile], progress: object) -> object:
    sizes = check_photos(files)
    files[2].path.unlink()
    return sizes


def test_photos_that_vanish_between_two_looks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_run, "check_photos", check_and_lose)
        assert run(site) == 2
    assert "2.png: cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize("spoilt", ["summary.json", "cameras.csv"])
def test_evaluation_of_a_spoilt_run(spoilt: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    assert run(site) == 3
    (site / "truth.csv").write_text("image,lat,lon,height\nairborne/0.png,27,-81,10\n")
    (site / "out" / spoilt).write_text('{"sets": [')
    before = content(site)
    capsys.readouterr()
    assert main(["evaluate", str(site / "out"), "--truth", str(site / "truth.csv")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and spoilt in lines[0]
    assert content(site) == before
