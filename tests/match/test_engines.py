# SPDX-License-Identifier: Apache-2.0
"""The choice of a matcher, and that one which is missing is told before any work."""

from __future__ import annotations

from pathlib import Path

import pytest

from skymoor.cli.main import main
from skymoor.engines.weights import stamps
from skymoor.errors import BackendUnavailable, InputError
from skymoor.match import AlikedMatcher, MatcherOptions, StructuralMatcher
from skymoor.pipeline.option_parser import with_options
from skymoor.pipeline.options import Options, check_engines


@pytest.fixture(autouse=True)
def no_weights(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path / "weights"))


def test_each_name_chooses_its_engine() -> None:
    assert MatcherOptions().engine == StructuralMatcher()
    assert MatcherOptions().ready() == ()
    for kind in ("structural", "aliked", "loftr", "tiny_roma", "roma", "romav2"):
        chosen = with_options(MatcherOptions(), {"kind": kind})
        assert chosen.engine is getattr(chosen, kind)
    with pytest.raises(InputError, match="one of"):
        with_options(MatcherOptions(), {"kind": "sift"})


def test_other_weights_under_the_same_name_are_noticed(tmp_path: Path) -> None:
    path = tmp_path / "some.pth"
    path.write_bytes(b"1")
    options = MatcherOptions(kind="aliked", aliked=AlikedMatcher(weights=str(path)))
    assert options.ready() == (path,)
    before = stamps(options.ready())
    path.write_bytes(b"22")
    assert stamps(options.ready()) != before
    assert stamps(options.ready())[0][:2] == (str(path), 2)


def test_what_is_missing_is_told_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing = with_options(Options(), {"match.dense.kind": "romav2"})
    with pytest.raises(BackendUnavailable, match="DINOv3"):
        check_engines(missing)
    # Only what is used must be there.
    check_engines(with_options(Options(), {"ground.matcher.kind": "romav2"}))
    with pytest.raises(BackendUnavailable):
        check_engines(with_options(Options(), {"ground.method": "cascade", "ground.matcher.kind": "romav2"}))
    for folder in ("photos", "ground"):
        (tmp_path / folder).mkdir()
    (tmp_path / "site.toml").write_text(
        '[reference]\northo = "o.tif"\ndsm = "d.tif"\nvertical_datum = "ellipsoid"\nce90 = 1.0\nle90 = 1.0\n'
        '[airborne]\nimages = "photos"\n'
    )
    for name in ("o.tif", "d.tif"):
        (tmp_path / name).touch()
    out = tmp_path / "out"
    assert main(["run", str(tmp_path / "site.toml"), "--out", str(out), "--set", "match.dense.kind=romav2"]) == 2
    shown = capsys.readouterr().err
    assert "accept_dinov3_licence" in shown and shown.count("\n") == 1
    assert not out.exists()
