# SPDX-License-Identifier: Apache-2.0
"""Engines are configured once, on one device, and what is missing is told before any work."""

from __future__ import annotations

from pathlib import Path

import pytest

from skymoor.cli.main import main
from skymoor.engines.options import files_of
from skymoor.engines.weights import stamps
from skymoor.errors import BackendUnavailable
from skymoor.match import AlikedMatcher, RomaMatcher, StructuralMatcher, XfeatMatcher
from skymoor.pipeline.engines import Engines
from skymoor.pipeline.option_parser import with_options
from skymoor.pipeline.options import Options, check_engines
from skymoor.reconstruct import AlikedPairMatcher, DedodeRomaMatcher, SiftMatcher


@pytest.fixture(autouse=True)
def no_weights(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path / "weights"))


def test_one_setting_reaches_all_stages_that_use_the_engine() -> None:
    engines = with_options(Engines(), {"device": "cpu", "roma.weights": "w", "roma.coarse_px": 280})
    roma = engines.dense_matcher("roma")
    assert roma == RomaMatcher("w", device="cpu", coarse_px=280)
    pairs = engines.pair_matcher("dedode_roma", shared_camera=False, exhaustive_below=7)
    assert isinstance(pairs, DedodeRomaMatcher) and pairs.dense == roma
    assert pairs.detector == engines._on_device(engines.dedode)
    assert (pairs.shared_camera, pairs.exhaustive_below) == (False, 7)


def test_aliked_serves_photos_and_the_render() -> None:
    engines = with_options(Engines(), {"device": "cpu", "aliked.features.weights": "w", "aliked.features.side_px": 800})
    assert engines.dense_matcher("aliked") == AlikedMatcher("w", "cpu", side_px=800)
    pairs = engines.pair_matcher("aliked", shared_camera=True, exhaustive_below=40)
    assert isinstance(pairs, AlikedPairMatcher)
    assert (pairs.features.weights, pairs.features.device, pairs.features.side_px) == ("w", "cpu", 800)


def test_the_defaults_need_nothing() -> None:
    engines = Engines()
    assert engines.dense_matcher("structural") == StructuralMatcher()
    assert engines.pair_matcher("sift", shared_camera=True, exhaustive_below=40) == SiftMatcher()
    assert engines.pair_filter("none") is engines.labeler("none") is engines.relative_depth("none") is None
    assert check_engines(Options()) == ()
    assert files_of(None, object(), StructuralMatcher()) == ()


def test_key_points_are_matched_where_the_weights_lie(tmp_path: Path) -> None:
    pytest.importorskip("kornia", reason="the extra of learned matchers is not installed")
    chosen = with_options(Options(), {"engines.device": "cpu"})
    assert chosen.ground.point_matcher(chosen.engines) is None
    with pytest.raises(BackendUnavailable, match="skymoor weights fetch xfeat"):
        check_engines(with_options(Options(), {"ground.key_points": "xfeat"}))
    weights = tmp_path / "weights/xfeat/xfeat-lighterglue.pt"
    weights.parent.mkdir(parents=True)
    weights.touch()
    assert chosen.ground.point_matcher(chosen.engines) == XfeatMatcher(device="cpu")
    # Part of what a run's results depend on, and only with ground photos that are laid by walls.
    assert check_engines(chosen) == (weights,) and check_engines(chosen, ground=False) == ()
    for options in ({"ground.key_points": "none"}, {"ground.method": "exhaustive"}):
        assert check_engines(with_options(chosen, options)) == ()


def test_other_weights_under_the_same_name_are_noticed(tmp_path: Path) -> None:
    path = tmp_path / "some.pth"
    path.write_bytes(b"1")
    matcher = AlikedMatcher(weights=str(path))
    assert matcher.ready() == (path,)
    before = stamps(matcher.ready())
    path.write_bytes(b"22")
    assert stamps(matcher.ready()) != before
    assert stamps(matcher.ready())[0][:2] == (str(path), 2)


def test_what_is_missing_is_told_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing = with_options(Options(), {"match.matcher": "romav2"})
    with pytest.raises(BackendUnavailable, match="DINOv3"):
        check_engines(missing)
    # Only what is used must be there.
    check_engines(with_options(Options(), {"ground.matcher": "romav2"}))
    with pytest.raises(BackendUnavailable):
        check_engines(with_options(Options(), {"ground.method": "cascade", "ground.matcher": "romav2"}))
    for folder in ("photos", "ground"):
        (tmp_path / folder).mkdir()
    (tmp_path / "site.toml").write_text(
        '[reference]\northo = "o.tif"\ndsm = "d.tif"\nvertical_datum = "ellipsoid"\nce90 = 1.0\nle90 = 1.0\n'
        '[airborne]\nimages = "photos"\n'
    )
    for name in ("o.tif", "d.tif"):
        (tmp_path / name).touch()
    out = tmp_path / "out"
    assert main(["run", str(tmp_path / "site.toml"), "--out", str(out), "--set", "match.matcher=romav2"]) == 2
    shown = capsys.readouterr().err
    assert "accept_dinov3_licence" in shown and shown.count("\n") == 1
    assert not out.exists()
