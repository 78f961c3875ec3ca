# SPDX-License-Identifier: Apache-2.0
"""Features kept beside an orthophoto find places that the coarser grid of a large reference no longer shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skymoor.cli.main import main
from skymoor.errors import InputError
from skymoor.match.features import TILE_PX, features_of
from skymoor.match.propose import propose
from skymoor.match.search import DECISIVE
from skymoor.pipeline.feature_index import checked_index, index_path, reference_features, write_index
from skymoor.reference.read import read_reference
from skymoor.store._files import FileDigests
from skymoor.types import Raster, Reference
from support.textured import PIXEL_M, SHAPE, cut, px_of, textured, write_map

WIDE = (900, TILE_PX + 300)
LIMITS = {"min_scale": 0.05, "max_scale": 1.0}


@pytest.fixture(scope="module")
def wide() -> Raster:
    return textured(WIDE, 1)


def coarse(ortho: Path, pixels: float = 20_000) -> Reference:
    return read_reference(ortho, None, None, np.eye(3), max_pixels=pixels)


@pytest.mark.parametrize("turn_deg", [0.0, 35.0])
def test_a_place_is_found_in_a_grid_that_is_too_coarse_for_it(wide: Raster, turn_deg: float, tmp_path: Path) -> None:
    ortho = write_map(tmp_path / "ortho.tif", wide, turn_deg)
    file, count = write_index(ortho)
    assert file == index_path(ortho) and count > 2000
    reference = coarse(ortho)
    assert reference.grid.pixel_m > 6 * PIXEL_M
    features = reference_features(reference, ortho, file)
    assert len(features) > 0.95 * count  # all but those at the border
    image = cut(wide, 0.5, 40.0, (1000.0, 420.0))
    best, *others = propose(image, features, **LIMITS, count=3)
    ratio = PIXEL_M / reference.grid.pixel_m
    assert best.inliers >= 2 * DECISIVE and all(one.inliers < DECISIVE for one in others)
    assert best.scale == pytest.approx(0.5 * ratio, rel=0.01)
    assert abs((np.degrees(best.azimuth_rad) - 40.0 + turn_deg + 180) % 360 - 180) < 1.0
    off_m = np.hypot(*(best.centre_px - px_of(reference, ortho, 1000.0, 420.0))) * reference.grid.pixel_m
    assert off_m < 0.3
    # Of the grid itself the image covers some 30 pixels, and nothing is found.
    alone = propose(image, features_of(Raster(reference.rgb, reference.mask)), **LIMITS, count=1)
    assert not alone or alone[0].inliers < DECISIVE
    assert SHAPE[0] * 0.5 * ratio < 40


def test_fine_orthophotos_are_averaged(wide: Raster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ortho = write_map(tmp_path / "ortho.tif", wide)
    monkeypatch.setattr("skymoor.pipeline.feature_index.FINEST_M", 1.0)
    write_index(ortho)
    reference = read_reference(ortho, None, None, np.eye(3))
    features = reference_features(reference, ortho, index_path(ortho))
    assert features.pixel == pytest.approx(2.0, rel=1e-3)
    best = propose(cut(wide, 1.0, 0.0, (700.0, 420.0)), features, min_scale=0.5, max_scale=2.0, count=1)[0]
    assert np.hypot(*(best.centre_px - px_of(reference, ortho, 700.0, 420.0))) < 1.5
    assert best.scale == pytest.approx(1.0, rel=0.02)


def test_an_index_of_another_orthophoto_or_a_damaged_one_is_not_used(wide: Raster, tmp_path: Path) -> None:
    ortho = write_map(tmp_path / "ortho.tif", wide)
    digests = FileDigests(tmp_path / "digests.json")
    assert checked_index(ortho, digests.sha256(ortho)) == (None, "")
    file, _ = write_index(ortho)
    assert checked_index(ortho, digests.sha256(ortho)) == (file, "")
    found, why = checked_index(ortho, "0" * 64)
    assert found is None and "another orthophoto" in why and str(ortho) in why
    file.write_bytes(file.read_bytes()[:1000])
    found, why = checked_index(ortho, digests.sha256(ortho))
    assert found is None and "damaged" in why


def test_the_command_says_what_it_wrote(wide: Raster, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ortho = write_map(tmp_path / "ortho.tif", wide)
    assert main(["index", str(ortho), "--quiet"]) == 0
    assert str(index_path(ortho)) in capsys.readouterr().out
    assert main(["index", str(tmp_path / "none.tif")]) == 2
    assert "there is no such file" in capsys.readouterr().err


def test_an_index_with_damage_is_told(wide: Raster, tmp_path: Path) -> None:
    ortho = write_map(tmp_path / "ortho.tif", wide)
    file, _ = write_index(ortho)
    with np.load(file) as kept:
        whole = dict(kept)
    for wrong in (
        {"px": whole["px"][:, :1]},
        {"size": whole["size"][:-1]},
        {"angle": whole["angle"] * np.nan},
        {"step": np.array(0)},
        {"step": np.array("x")},
    ):
        np.savez(file, **{**whole, **wrong})
        with pytest.raises(InputError, match="make it again with skymoor index"):
            reference_features(coarse(ortho), ortho, file)
    np.savez(file, **{name: value for name, value in whole.items() if name != "descriptors"})
    with pytest.raises(InputError, match="descriptors"):
        reference_features(coarse(ortho), ortho, file)
    content = file.read_bytes()
    file.write_bytes(content[:200])
    assert checked_index(ortho, "")[0] is None and "is damaged" in checked_index(ortho, "")[1]
