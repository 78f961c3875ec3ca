# SPDX-License-Identifier: Apache-2.0
"""Key points joined by a warp: by hand, through COLMAP's database, and with a detector that is not trained."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import skymoor.reconstruct._dedode
from skymoor.engines.libraries import require
from skymoor.errors import InputError
from skymoor.reconstruct import DedodeDetector, DedodeRomaMatcher, ReconstructOptions, ViewGraph, reconstruct
from skymoor.reconstruct._dedode_roma import match_keypoints
from skymoor.reconstruct.database import likely_pairs
from skymoor.reconstruct.graph import view_graph
from skymoor.types import Array32, Camera, Image, Photos, Raster, Warp, no_progress
from support.blocks import ground_points, ring
from support.pictures import noise_picture

Array = NDArray[np.float64]
SIZE = (400, 300)


@pytest.fixture(autouse=True)
def forget_networks() -> Iterator[None]:
    yield
    skymoor.reconstruct._dedode._network.cache_clear()


def centres(shape: tuple[int, int]) -> Array:
    return np.stack(np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5), axis=-1)


class TestMatching:
    shape = (60, 80)

    def shifted(self, shift: tuple[float, float], confidence: float = 1.0) -> Warp:
        there, back = (centres(self.shape) + sign * np.array(shift) for sign in (1, -1))
        sure = np.full(self.shape, confidence, np.float32)
        return Warp(there.astype(np.float32), sure, back.astype(np.float32), sure.copy())

    def test_nearest_both_ways(self) -> None:
        """The third point has two that are near it, the fourth none that is near enough."""
        a = np.array([[10, 10], [30.2, 20.7], [50, 30], [20, 40]], float)
        b = np.array([[54.9, 28], [35.2, 18.7], [55.6, 28], [15, 8], [25, 40.5]], float)
        found = match_keypoints(self.shifted((5, -2)), a, b, max_distance_px=2.0, min_confidence=0.2)
        assert found.tolist() == [[0, 3], [1, 1], [2, 0]]
        assert found.dtype == np.uint32
        near = match_keypoints(self.shifted((5, -2)), a, b, max_distance_px=3.0, min_confidence=0.2)
        assert near.tolist() == [[0, 3], [1, 1], [2, 0], [3, 4]]

    def test_the_way_back_must_agree(self) -> None:
        warp = self.shifted((5, -2))
        warp.a_from_b[:, :40] += 6  # the left half of b leads elsewhere
        a = np.array([[10, 10], [60, 30]], float)
        assert match_keypoints(warp, a, a + [5, -2], max_distance_px=2.0, min_confidence=0.2).tolist() == [[1, 1]]

    def test_confidence_at_both_ends(self) -> None:
        a = np.array([[10, 10], [60, 30], [40, 50]], float)
        warp = self.shifted((5, -2), confidence=0.5)
        warp.confidence_a[10, 10] = 0.1
        warp.confidence_b[28, 65] = 0.1
        assert match_keypoints(warp, a, a + [5, -2], max_distance_px=2.0, min_confidence=0.2).tolist() == [[2, 2]]

    def test_no_key_points_and_none_that_is_led_into_the_picture(self) -> None:
        a, nothing = np.array([[10.0, 10.0]]), np.zeros((0, 2))
        for one, other in ((a, nothing), (nothing, a), (nothing, nothing)):
            found = match_keypoints(self.shifted((0, 0)), one, other, max_distance_px=2.0, min_confidence=0.2)
            assert found.shape == (0, 2)
        warp = self.shifted((0, 0))
        warp.b_from_a[...] = np.nan
        assert not len(match_keypoints(warp, a, a, max_distance_px=2.0, min_confidence=0.2))


@dataclass(frozen=True, eq=False)
class World:
    """Points on rough ground and cameras that see them. A photo is grey, and its grey is its number."""

    points: Array
    cameras: list[Camera]

    @property
    def photos(self) -> Photos:
        names = tuple(camera.image for camera in self.cameras)
        sizes = (SIZE,) * len(names)

        def read(name: str) -> Image:
            return np.full((SIZE[1], SIZE[0], 3), 10 * names.index(name), np.uint8)

        return Photos(names, sizes, read)

    def number(self, image: Image) -> int:
        return int(image[0, 0, 0]) // 10

    def px(self, k: int) -> Array:
        """Where every point is in photo k."""
        camera = self.cameras[k]
        return camera.intrinsics.px_from_cam(camera.cam_from_world.apply(self.points))

    def inside(self, k: int) -> NDArray[np.bool_]:
        return np.asarray(((self.px(k) > 0) & (self.px(k) < SIZE)).all(axis=1))

    def detect(self, image: Image) -> Array:
        """The points in the photo, to 0.3 px, in an order of its own, and as many that belong to nothing."""
        k = self.number(image)
        rng = np.random.default_rng(k)
        true = self.px(k)[self.inside(k)] + rng.normal(scale=0.3, size=(np.count_nonzero(self.inside(k)), 2))
        return rng.permutation(np.vstack([true, rng.uniform([0, 0], SIZE, (100, 2))]))

    def warp(self, a: Raster, b: Raster) -> Warp:
        """Everything moves as the nearest point does; sure where that is near and in the other photo, too."""
        assert a.rgb.shape[:2] == b.rgb.shape[:2]
        ratio = a.rgb.shape[1] / SIZE[0]
        i, j = self.number(a.rgb), self.number(b.rgb)
        shape = a.mask.shape
        return Warp(*self._flow(i, j, shape, ratio), *self._flow(j, i, shape, ratio))

    def _flow(self, i: int, j: int, shape: tuple[int, ...], ratio: float) -> tuple[Array32, Array32]:
        here, there = self.px(i)[self.inside(i)] * ratio, self.px(j)[self.inside(i)] * ratio
        grid = centres((shape[0], shape[1]))
        apart, nearest = cKDTree(here).query(grid.reshape(-1, 2))
        flow = grid + np.nan_to_num(there - here, nan=-1e3)[nearest].reshape(grid.shape)
        seen = self.inside(j)[self.inside(i)][nearest] & (apart < 6)
        return flow.astype(np.float32), seen.reshape(shape[:2]).astype(np.float32) * 0.9


@pytest.fixture(scope="module")
def world() -> World:
    return World(ground_points(350, relief_m=12.0, extent_m=30.0), ring(8))


def filled(world: World, folder: Path, **options: float) -> ViewGraph:
    matcher = DedodeRomaMatcher(world.warp, world.detect, **options)  # type: ignore[arg-type]
    matcher(world.photos, folder / "database.db", folder, seed=0, progress=no_progress)
    with pycolmap.Database.open(folder / "database.db") as db:
        return view_graph(db, world.photos, ())


def points_of(world: World, k: int, px: Array) -> tuple[NDArray[np.intp], Array]:
    """Which point each key point is of, and how far off."""
    apart, index = cKDTree(np.nan_to_num(world.px(k), nan=-1e3)).query(px)
    return index, apart


@pytest.fixture(scope="module")
def database(world: World, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ViewGraph]:
    folder = tmp_path_factory.mktemp("filled")
    return folder / "database.db", filled(world, folder)


class TestDatabase:
    def test_matches_are_of_the_same_points(self, world: World, database: tuple[Path, ViewGraph]) -> None:
        _, graph = database
        neighbours = [(k, pair) for k, pair in enumerate(graph.pairs) if abs(pair[0] - pair[1]) in (1, 7)]
        assert len(neighbours) == 8
        for k, (i, j) in neighbours:
            of_i, off_i = points_of(world, i, graph.matches[k][:, :2])
            of_j, off_j = points_of(world, j, graph.matches[k][:, 2:])
            common = np.count_nonzero(world.inside(i) & world.inside(j))
            assert 0.6 * common < len(of_i) <= common
            assert np.mean(of_i == of_j) > 0.97
            assert 0.25 < np.median([off_i, off_j]) < 0.5  # of 0.3 px in two dimensions 0.35

    def test_two_view_geometries_are_those_of_the_cameras(self, world: World, database: tuple[Path, ViewGraph]) -> None:
        """The exact points fit the epipolar geometry that COLMAP found from what the matcher wrote."""
        path, graph = database
        with pycolmap.Database.open(path) as db:
            ids = {image.name[-10:-4]: image.image_id for image in db.read_all_images()}
            for i, j in ((0, 1), (3, 4)):
                geometry = db.read_two_view_geometry(ids[f"{i:06d}"], ids[f"{j:06d}"])
                both = world.inside(i) & world.inside(j)
                a, b = (np.column_stack([world.px(k)[both], np.ones(np.count_nonzero(both))]) for k in (i, j))
                lines = a @ np.asarray(geometry.F).T
                off = np.abs(np.sum(lines * b, axis=1)) / np.linalg.norm(lines[:, :2], axis=1)
                assert 0.01 < np.median(off) < 1.0
        assert len(graph.pairs) >= 8

    def test_through_to_the_cameras(self, world: World) -> None:
        """The reconstruction from these matches has all the cameras, where they were but for a similarity."""
        options = ReconstructOptions(DedodeRomaMatcher(world.warp, world.detect))
        (component,) = reconstruct(world.photos, options, seed=0)
        assert len(component.cameras) == 8
        truth = {camera.image: camera.centre for camera in world.cameras}
        found = component.centres - component.centres.mean(axis=0)
        true = np.array([truth[camera.image] for camera in component.cameras])
        true -= true.mean(axis=0)
        shape, wanted = (np.linalg.norm(x[:, None] - x, axis=2) for x in (found, true))
        ratio = shape[wanted > 0] / wanted[wanted > 0]
        assert 1e-5 < np.std(ratio) / np.mean(ratio) < 0.02

    def test_photos_reduced_for_the_warp(self, world: World, tmp_path: Path) -> None:
        """Key points stay in pixels of the whole photos."""
        graph = filled(world, tmp_path, side_px=200)
        (k,) = (k for k, pair in enumerate(graph.pairs) if set(pair) == {0, 1})
        i, j = graph.pairs[k]
        of_i, _ = points_of(world, i, graph.matches[k][:, :2])
        of_j, _ = points_of(world, j, graph.matches[k][:, 2:])
        assert len(of_i) > 80 and np.mean(of_i == of_j) > 0.9

    def test_nothing_in_common(self, world: World, tmp_path: Path) -> None:
        assert filled(world, tmp_path, min_confidence=0.95).pairs == ()

    def test_partners_in_larger_sets(self) -> None:
        """Two places with three photos each, slightly moved: nobody gets a partner at the other place."""
        places = [noise_picture((240, 320)), np.ascontiguousarray(noise_picture((240, 320))[::-1, :, [1, 2, 0]])]
        pictures = [np.roll(places[k // 3], 12 * (k % 3), axis=1) for k in range(6)]
        photos = Photos(tuple("abcdef"), ((320, 240),) * 6, lambda name: pictures["abcdef".index(name)])
        assert likely_pairs(photos, exhaustive_below=3, neighbours=2) == [
            (0, 1),
            (0, 2),
            (1, 2),
            (3, 4),
            (3, 5),
            (4, 5),
        ]


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    network = require("kornia.feature", "kornia").DeDoDe("L", "B", torch.float32)
    path = tmp_path_factory.mktemp("weights") / "dedode_detector_L.pth"
    torch.save(network.detector.state_dict(), path)
    return path


class TestDetector:
    def test_the_real_network(self, weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """With random weights it finds anything; with a score that is known, the centres of the right pixels."""
        found = DedodeDetector(str(weights), "cpu", max_keypoints=50)(noise_picture((70, 98)))
        assert found.shape == (50, 2) and (found > 0).all() and (found < [98, 70]).all()
        network = skymoor.reconstruct._dedode._network(weights, "cpu")
        peaks = np.array([[10, 20], [50, 40], [80, 60]])

        def score(picture: torch.Tensor) -> torch.Tensor:
            logits = torch.zeros(1, 1, *picture.shape[2:])
            for column, row in peaks:
                logits[..., row, column] = 50
            return logits

        monkeypatch.setattr(network.detector, "forward", score)
        exact = DedodeDetector(str(weights), "cpu", max_keypoints=3)(noise_picture((70, 98)))
        np.testing.assert_allclose(sorted(exact.tolist()), peaks + 0.5, atol=1e-4)
        half = DedodeDetector(str(weights), "cpu", max_keypoints=3, side_px=98)(noise_picture((140, 196)))
        np.testing.assert_allclose(sorted(half.tolist()), 2 * peaks + 1, atol=1e-4)

    def test_options_that_make_no_sense(self) -> None:
        with pytest.raises(InputError, match="side_px = 10"):
            DedodeDetector(side_px=10)
