# SPDX-License-Identifier: Apache-2.0
"""ALIKED's key points as matches of photos, in PyTorch and in COLMAP, with weights that are not trained."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pycolmap
import pytest
import torch
from numpy.typing import NDArray

import skymoor.engines.aliked
import skymoor.reconstruct._aliked
from skymoor.engines.aliked import AlikedFeatures
from skymoor.engines.libraries import require
from skymoor.errors import BackendUnavailable, InputError
from skymoor.reconstruct import AlikedPairMatcher, ColmapAlikedMatcher, ViewGraph
from skymoor.reconstruct.database import enter_photos, extract, match
from skymoor.reconstruct.graph import view_graph
from skymoor.reconstruct.protocol import colmap_name
from skymoor.types import Image, Photos, no_progress
from support.flight import Flight
from support.pictures import noise_picture

Array = NDArray[np.float64]
STEP = 32  # pixels by which photos are apart: the network reduces by this much, and sees the same again


def photos_of(images: dict[str, Image]) -> Photos:
    sizes = tuple((image.shape[1], image.shape[0]) for image in images.values())
    return Photos(tuple(images), sizes, images.__getitem__)


@pytest.fixture(autouse=True)
def forget_networks() -> Iterator[None]:
    yield
    skymoor.engines.aliked._network.cache_clear()
    skymoor.reconstruct._aliked._lightglue.cache_clear()


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of both networks, as they are published."""
    feature, folder = require("kornia.feature", "kornia"), tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    tensors = feature.ALIKED("aliked-n16rot").state_dict()
    torch.save({name: x for name, x in tensors.items() if name != "dkd.hw_grid"}, folder / "aliked.pth")
    library = feature.LightGlue
    joining = library(features=None, **{**library.features["aliked"], "weights": None})
    # As it is published: by older names, without what can be computed.
    named = {
        re.sub(r"transformers\.(\d)\.(self|cross)_attn", r"\2_attn.\1", n): x for n, x in joining.state_dict().items()
    }
    assert "self_attn.3.Wqkv.weight" in named
    del named["confidence_thresholds"]
    torch.save(named, folder / "lightglue.pth")
    return folder


@pytest.fixture
def matcher(weights: Path) -> AlikedPairMatcher:
    features = AlikedFeatures(str(weights / "aliked.pth"), "cpu", max_keypoints=400)
    return AlikedPairMatcher(features, lightglue=str(weights / "lightglue.pth"), max_ratio=1.0)


@pytest.fixture(scope="module")
def photos() -> Photos:
    """Three photos along a wall, and one of another."""
    whole, other = noise_picture((224, 352)), noise_picture((192, 256), seed=7)
    images = {f"{k}": np.ascontiguousarray(whole[:192, k * STEP : k * STEP + 256]) for k in range(3)}
    return photos_of({**images, "other": other})


def filled(matcher: AlikedPairMatcher, photos: Photos, folder: Path) -> ViewGraph:
    told: list[tuple[int, int]] = []
    matcher(photos, folder / "d.db", folder, seed=0, progress=lambda done, of, _="": told.append((done, of)))
    assert told[-1] == (3 * len(photos), 3 * len(photos))
    with pycolmap.Database.open(folder / "d.db") as db:
        return view_graph(db, photos, ())


def test_nearest_descriptions(matcher: AlikedPairMatcher, photos: Photos, tmp_path: Path) -> None:
    """Verified matches of neighbours are those moved by the step, to a fraction of a pixel; the other has few."""
    graph = filled(matcher, photos, tmp_path)
    assert {(0, 1), (1, 2)} <= set(graph.pairs)
    for pair, matches in zip(graph.pairs, graph.matches, strict=True):
        # Not trained, the network takes some of the other photo for the same.
        assert 3 not in pair or len(matches) < 0.5 * len(graph.matches[graph.pairs.index((0, 1))])
        if pair in ((0, 1), (1, 2)):
            error = matches[:, 2:] - matches[:, :2] + [STEP, 0]
            assert len(error) > 40 and np.median(np.linalg.norm(error, axis=1)) < 0.1


def test_in_larger_sets_partners_are_those_that_look_alike(
    matcher: AlikedPairMatcher, photos: Photos, tmp_path: Path
) -> None:
    few = replace(matcher, exhaustive_below=2, neighbours=1)
    found = [few.features(photos.read(name)) for name in photos.names]
    assert {(0, 1), (1, 2)} <= set(few._pairs(found)) < {(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)}
    assert (0, 1) in filled(few, photos, tmp_path).pairs


class TestLightGlue:
    def test_the_real_network(self, matcher: AlikedPairMatcher, photos: Photos) -> None:
        """Not trained it joins anything; what it joins are rows of both, each at most once."""
        a, b = (matcher.features(photos.read(name)) for name in ("0", "1"))
        index = replace(matcher, join="lightglue", min_confidence=0.0)._lightglue(a, b, (256, 192), (256, 192))
        assert index.ndim == 2 and index.shape[1] == 2
        assert (index < [len(a[0]), len(b[0])]).all()
        assert len(np.unique(index[:, 0])) == len(index) == len(np.unique(index[:, 1]))

    def test_input_and_output_of_lightglue(
        self, matcher: AlikedPairMatcher, photos: Photos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Pixels count from the centre of the first one, sizes are (width, height), unsure matches are left out."""
        pixels: dict[bytes, Array] = {}

        def answer(given: dict[str, dict[str, torch.Tensor]]) -> dict[str, list[torch.Tensor]]:
            assert [given[k]["image_size"].tolist() for k in ("image0", "image1")] == [[[256, 192]]] * 2
            a, b = (given[k]["keypoints"][0].numpy() for k in ("image0", "image1"))
            for k in ("image0", "image1"):
                pixels[given[k]["descriptors"].numpy().tobytes()] = given[k]["keypoints"][0].numpy()
            gap = np.linalg.norm(a[:, None] - [STEP, 0] - b, axis=2)
            rows = np.flatnonzero(gap.min(axis=1) < 0.2)
            index = torch.from_numpy(np.column_stack([rows, gap.argmin(axis=1)[rows]]))
            scores = torch.full((len(rows),), 0.9)
            scores[::2] = 0.05
            return {"matches": [index], "scores": [scores]}

        monkeypatch.setattr(skymoor.reconstruct._aliked, "_lightglue", lambda *_: answer)
        near = photos_of({name: photos.read(name) for name in ("0", "1")})
        graph = filled(replace(matcher, join="lightglue"), near, tmp_path)
        (matches,) = graph.matches
        np.testing.assert_allclose(matches[:, 2:] - matches[:, :2], np.tile([-STEP, 0.0], (len(matches), 1)), atol=0.2)
        found, described = matcher.features(photos.read("0"))
        np.testing.assert_allclose(pixels[described[None].numpy().tobytes()], found - 0.5, atol=1e-4)
        assert 20 < len(matches) <= len(found) // 2 + 1

    def test_weights(self, matcher: AlikedPairMatcher, weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        glue = replace(matcher, join="lightglue")
        assert matcher.ready() == (weights / "aliked.pth",)
        assert glue.ready() == (weights / "aliked.pth", weights / "lightglue.pth")
        a = matcher.features(noise_picture((96, 96)))
        wrong = replace(glue, lightglue=str(weights / "aliked.pth"))
        with pytest.raises(InputError, match=r"aliked\.pth: weights of another network"):
            wrong._lightglue(a, a, (96, 96), (96, 96))
        monkeypatch.setenv("SKYMOOR_WEIGHTS", str(weights / "none"))
        with pytest.raises(BackendUnavailable, match="skymoor weights fetch lightglue-aliked"):
            replace(glue, lightglue="").ready()
        with pytest.raises(InputError, match="max_ratio = 2"):
            AlikedPairMatcher(max_ratio=2.0)


class TestColmap:
    def test_builds_without_onnx_say_so(self) -> None:
        """And do not end the process, as extraction itself would."""
        if hasattr(pycolmap.FeatureExtractionOptions(), "aliked"):
            pytest.skip("this build of pycolmap has ONNX")
        with pytest.raises(BackendUnavailable, match=r"has no ONNX.*reconstruct.matcher = aliked"):
            ColmapAlikedMatcher().ready()

    @pytest.mark.parametrize(("join", "model"), [("lightglue", "aliked-lightglue"), ("nearest", "bruteforce-matcher")])
    def test_models_come_from_the_disk_alone(
        self, join: Any, model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """No default path stays, for COLMAP would download what that names."""

        class Known:
            def __init__(self, **_: Any) -> None:
                self.aliked = SimpleNamespace()

        monkeypatch.setattr(pycolmap, "FeatureExtractionOptions", Known)
        monkeypatch.setattr(pycolmap, "FeatureMatchingOptions", Known)
        engine = ColmapAlikedMatcher(str(tmp_path), join=join)
        with pytest.raises(InputError, match=r"aliked-n16rot\.onnx: there are no weights here"):
            engine.ready()
        for name in ("aliked-n16rot.onnx", f"{model}.onnx"):
            (tmp_path / name).touch()
        features, joint = engine.ready()
        extraction, matching = engine._options(features, joint)
        assert extraction.aliked.n16rot_model_path == str(tmp_path / "aliked-n16rot.onnx")
        assert vars(matching.aliked) == {f"{model.split('-')[0 if join == 'nearest' else 1]}_model_path": str(joint)}
        assert joint == tmp_path / f"{model}.onnx"

    def test_what_it_is_given_in_colour_colmap_can_read(self, flight: Flight, tmp_path: Path) -> None:
        """By SIFT, which every build has: key points as in grey photos, but for the weights of colours."""
        names = [flight.cameras[k].image for k in flight.from_above[:2]]
        photos = photos_of({name: flight.images[name] for name in names})
        found = {}
        for grey in (True, False):
            folder = tmp_path / str(grey)
            folder.mkdir()
            enter_photos(photos, folder / "d.db", shared_camera=True)
            options = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1)
            options.sift.max_num_features = 500
            extract(photos, folder / "d.db", folder, options, grey=grey, shared_camera=True, report=lambda _: None)
            assert not [path for path in folder.rglob("*") if path.suffix == ".pgm"]
            matching = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=1)
            pairs = [(0, 1)]
            match(
                photos,
                folder / "d.db",
                folder,
                pairs,
                matching,
                block_pairs=4,
                seed=0,
                report=lambda n: no_progress(n, 1),
            )
            with pycolmap.Database.open(folder / "d.db") as db:
                image = db.read_image_with_name(colmap_name(0, photos.sizes[0]))
                assert image is not None
                found[grey] = db.read_keypoints(image.image_id)[:, :2]
                assert len(view_graph(db, photos, ()).pairs) == 1
        gaps = np.linalg.norm(found[True][:, None] - found[False], axis=2).min(axis=1)
        assert np.mean(gaps < 0.5) > 0.8
