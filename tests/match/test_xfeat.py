# SPDX-License-Identifier: Apache-2.0
"""XFeat and LighterGlue with random weights, saved and read as trained ones; what is trained is measured elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

import skymoor.match._xfeat
from skymoor.errors import InputError
from skymoor.match import XfeatMatcher
from skymoor.types import Raster
from support.pictures import noise_picture

Image = NDArray[np.uint8]


def raster(picture: Image) -> Raster:
    return Raster(picture, np.ones(picture.shape[:2], bool))


def saved(folder: Path, **changed: torch.Tensor) -> XfeatMatcher:
    """Both networks in one file, under the names by which they are published."""
    from kornia.feature import LightGlue, XFeat

    torch.manual_seed(0)
    matcher = LightGlue(features=None, **{**LightGlue.features["xfeat"], "weights": None})
    tensors = {f"extractor.model.net.{name}": x for name, x in XFeat().net.state_dict().items()}
    # Untrained, it is not sure of any point.
    tensors["extractor.model.net.keypoint_head.3.weight"] *= 100
    names = matcher.state_dict().items()
    tensors |= {f"matcher.{name}": x for name, x in names if name != "confidence_thresholds"}
    torch.save(tensors | changed, folder / "both.pt")
    return XfeatMatcher(str(folder / "both.pt"), "cpu")


@pytest.fixture
def xfeat(tmp_path: Path) -> XfeatMatcher:
    return saved(tmp_path)


def nearest(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Each other's nearest descriptors in place of LighterGlue, which joins nothing untrained; what it is given."""
    given: list[dict[str, Any]] = []
    networks = skymoor.match._xfeat._networks

    def joined(inputs: dict[str, Any]) -> dict[str, Any]:
        given.append(inputs)
        alike = inputs["image0"]["descriptors"][0] @ inputs["image1"]["descriptors"][0].T
        i = torch.arange(len(alike))
        i = i[alike.argmax(0)[alike.argmax(1)] == i]
        return {"matches": [torch.stack([i, alike.argmax(1)[i]], 1)]}

    monkeypatch.setattr(skymoor.match._xfeat, "_networks", lambda *a: (networks(*a)[0], joined))
    return given


def test_shifted_picture(xfeat: XfeatMatcher, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a multiple of what the network reduces by, it sees the same, trained or not."""
    given = nearest(monkeypatch)
    whole = noise_picture((224, 288))
    px_a, px_b = xfeat(raster(whole[:192, :256].copy()), raster(whole[32:224, 32:288].copy()))
    right = np.linalg.norm(px_b - px_a + 32, axis=1) < 0.1
    assert right.sum() > 50 and right.mean() > 0.4  # near the border it does not see the same
    assert given[0]["image1"]["image_size"].tolist() == [[256, 192]]
    # LighterGlue counts from the centre of the first pixel.
    points = given[0]["image0"]["keypoints"][0].numpy() + 0.5
    assert {*map(tuple, px_a)} <= {*map(tuple, points.astype(np.float64))}


def test_masked_points_do_not_count(xfeat: XfeatMatcher, monkeypatch: pytest.MonkeyPatch) -> None:
    nearest(monkeypatch)
    a, b = raster(noise_picture((128, 192))), raster(noise_picture((128, 192)))
    a.mask[:, :96] = False
    px_a, px_b = xfeat(a, b)
    assert len(px_a) == len(px_b) > 20 and px_a[:, 0].min() > 96 + 4


def test_the_real_networks_run(xfeat: XfeatMatcher) -> None:
    """Untrained, LighterGlue may join nothing; what it joins is within the images."""
    a, b = raster(noise_picture((96, 128))), raster(noise_picture((96, 128)))
    px_a, px_b = xfeat(a, b)
    assert px_a.shape == px_b.shape and px_a.shape[1] == 2
    assert ((px_a >= 0) & (px_a <= [128, 96])).all()
    a.mask[:] = False
    assert xfeat(a, b)[0].shape == (0, 2)


def test_weights_of_other_networks_are_refused(tmp_path: Path) -> None:
    a = raster(noise_picture((96, 128)))
    other = saved(tmp_path, **{"extractor.model.net.more": torch.zeros(1)})
    with pytest.raises(InputError, match=r"both\.pt: weights of another network \(holds more\)"):
        other(a, a)
    torch.save({"matcher.posenc.Wr.weight": torch.zeros(1)}, tmp_path / "half.pt")
    with pytest.raises(InputError, match=r"half\.pt: weights of another network \(lacks "):
        XfeatMatcher(str(tmp_path / "half.pt"), "cpu")(a, a)
