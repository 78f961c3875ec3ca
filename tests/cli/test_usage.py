# SPDX-License-Identifier: Apache-2.0
"""Wrong usage is one line that names the nearest right one; help and version have words of their own."""

from __future__ import annotations

from pathlib import Path

import pytest

from skymoor import __version__
from skymoor.cli.main import COMMANDS, main
from skymoor.pipeline.words import size_in_words, time_in_words
from support.tiny_site import SITE, make_site


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("run --airbone x --out r", "run: there is no option --airbone; did you mean --airborne?"),
        ("run --out=r --airborn=x", "run: there is no option --airborn; did you mean --airborne?"),
        ("export r --tp kml --out x", "export: there is no option --tp; did you mean --to?"),
        ("run --quite --out r", "run: there is no option --quite; did you mean --quiet?"),
        ("weights fetch roma --too x", "weights fetch: there is no option --too; did you mean --to?"),
        ("run -out r", "run: there is no option -out; did you mean --out?"),
        ("run --qqqq", "run: there is no option --qqqq; skymoor run --help lists all"),
        ("--versoin", "there is no option --versoin; did you mean --version?"),
        ("run", "run: --out PATH is missing; skymoor run --help explains it"),
        ("evaluate r", "evaluate: --truth PATH is missing; skymoor evaluate --help explains it"),
        ("run --out r --seed x", "run: --seed 'x' must be a whole number; skymoor run --help explains it"),
        ("run --out r --ce90 x", "run: --ce90 'x' must be a number; skymoor run --help explains it"),
        (
            "run --out r --stop-after x",
            "run: --stop-after 'x' must be depth, reconstruct or search; skymoor run --help explains it",
        ),
        ("run --out r --accuracy x", "run: --accuracy 'x' must be unknown; skymoor run --help explains it"),
        ("run a b --out c", "run: not understood: b; skymoor run --help explains it"),
        ("weights", "weights: Expected one of {list, fetch}; skymoor weights --help explains it"),
    ],
)
def test_wrong_usage_is_one_line(arguments: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments.split()) == 2
    assert capsys.readouterr().err == f"skymoor: {line}\n"


def test_help_and_version_are_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["version"]) == 0
    assert capsys.readouterr().out == f"{__version__}\n"
    with pytest.raises(SystemExit) as ended:
        main(["help", "init"])
    assert not ended.value.code and "usage: skymoor init" in capsys.readouterr().out
    assert main(["help", "rnu"]) == 2
    assert capsys.readouterr().err == "skymoor: there is no command rnu; did you mean run?\n"
    assert main(["help", "nonsense"]) == 2
    assert capsys.readouterr().err == "skymoor: there is no command nonsense; skymoor help lists all\n"


@pytest.mark.parametrize("arguments", [[], ["help"], ["--help"], ["-h"]])
def test_all_commands_are_listed_on_one_screen(
    arguments: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines if line.startswith("  ") and line[2] != " "} == set(COMMANDS)
    assert len(lines) <= 60 and max(map(len, lines)) <= 80 and any("skymoor demo" in line for line in lines)


@pytest.mark.parametrize("command", ["run", "register", "init", "report", "weights fetch"])
def test_help_offers_neither_none_nor_defaults_that_say_nothing(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    shown = capsys.readouterr().out
    assert "None" not in shown and "(default: )" not in shown and "False" not in shown and "--no-" not in shown
    assert command != "run" or "(default: 0)" in shown


def test_the_folder_of_a_site_is_as_good_as_its_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    assert main(["run", str(site), "--out", str(site / "out"), "--dry-run"]) == 0
    assert f"{site / 'site.toml'}: this file in the folder is used" in capsys.readouterr().out
    photos = str(site / "airborne")
    for more in ((), ("--ortho", str(site / "ortho.tif"))):
        assert main(["run", photos, *more, "--out", str(site / "out")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "is a folder without site.toml" in line and f"--airborne {photos}" in line and "skymoor init" in line


def test_all_problems_of_a_site_are_told_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    site = make_site(tmp_path)
    spoilt = SITE.replace("ortho =", "orto =").replace('"airborne"', '["airborne", "seond"]').replace("le90 = 3.8", "")
    (site / "site.toml").write_text(spoilt, encoding="utf-8")
    assert main(["run", str(site / "site.toml"), "--out", str(site / "out")]) == 2
    first, *lines = capsys.readouterr().err.splitlines()
    assert first == f"skymoor: {site / 'site.toml'}: 3 problems"
    assert any("unknown key orto in [reference]; did you mean ortho?" in line for line in lines)
    assert any("airborne.images: there is no folder" in line and "seond" in line for line in lines)
    assert any("le90 missing" in line for line in lines) and any("Copernicus" in line for line in lines)
    assert not any("ortho is missing" in line for line in lines)  # it is there, misspelt
    assert not (site / "out").exists()


@pytest.mark.parametrize(
    ("count", "words"), [(999, "1.0 kB"), (12, "12 bytes"), (1.24e9, "1.2 GB"), (31e6, "31 MB"), (2e12, "2.0 TB")]
)
def test_sizes(count: float, words: str) -> None:
    assert size_in_words(count) == words


@pytest.mark.parametrize(
    ("seconds", "words"), [(0, "0 s"), (50, "50 s"), (89, "89 s"), (240, "4 min"), (5400, "1.5 h"), (36000, "10 h")]
)
def test_times(seconds: float, words: str) -> None:
    assert time_in_words(seconds) == words
