# SPDX-License-Identifier: Apache-2.0
"""COLMAP's depth maps: read, confirmed by one another, and asked for. No GPU: a stand-in writes what COLMAP would."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

from skymoor.densify import PatchMatchDepth, empty_depth_map, read_colmap_depth
from skymoor.densify._patchmatch import write_workspace
from skymoor.densify.consistency import confirmed
from skymoor.densify.neighbours import stereo_partners
from skymoor.errors import BackendUnavailable, InputError
from skymoor.types import Array32, Camera, Component, DepthMap, Photos
from support.blocks import ground_points, observed, strips
from support.pictures import noise_picture

NOISE_RATIO = 0.002
WRONG_SHARE = 0.1


@pytest.fixture(scope="module")
def component() -> Component:
    """Twelve photos from 60 m above flat ground."""
    return observed(strips(), ground_points(900, relief_m=0.0))


@pytest.fixture(scope="module")
def photos(component: Component) -> Photos:
    names = tuple(camera.image for camera in component.cameras)
    picture = noise_picture((300, 400))
    return Photos(names, ((400, 300),) * len(names), lambda _: picture)


def true_depth(camera: Camera) -> Array32:
    """Of the plane z = 0."""
    i = camera.intrinsics
    u, v = np.meshgrid(np.arange(i.width) + 0.5, np.arange(i.height) + 0.5)
    up = i.rays(np.column_stack([u.ravel(), v.ravel()])) @ camera.cam_from_world.rotation[:, 2]
    return (-camera.centre[2] / up).reshape(i.height, i.width).astype(np.float32)


def erring(camera: Camera, seed: int) -> tuple[Array32, NDArray[np.bool_]]:
    """With noise, holes of zeros, and a tenth of depths that are quite wrong, which the mask marks."""
    rng = np.random.default_rng(seed)
    depth = true_depth(camera) * (
        1 + NOISE_RATIO * rng.normal(size=(camera.intrinsics.height, camera.intrinsics.width))
    )
    wrong = rng.uniform(size=depth.shape) < WRONG_SHARE
    depth = np.where(wrong, depth * rng.uniform(0.6, 0.95, depth.shape), depth)
    depth[:20] = 0
    return depth.astype(np.float32), wrong


def write_map(path: Path, values: Array32) -> None:
    h, w = values.shape[:2]
    planes = values.reshape(h, w, -1)
    content = np.ascontiguousarray(np.moveaxis(planes, -1, 0), "<f4").tobytes()
    path.write_bytes(f"{w}&{h}&{planes.shape[2]}&".encode() + content)


class TestReading:
    def test_what_the_test_writes_and_what_colmap_writes(self, tmp_path: Path, rng: np.random.Generator) -> None:
        depth = rng.uniform(1, 5, (6, 9)).astype(np.float32)
        write_map(tmp_path / "ours.bin", depth)
        pycolmap.DepthMap.from_array(depth, 1.0, 5.0).write(tmp_path / "theirs.bin")
        for name in ("ours.bin", "theirs.bin"):
            np.testing.assert_array_equal(read_colmap_depth(tmp_path / name), depth)

    def test_bad_files(self, tmp_path: Path) -> None:
        path = tmp_path / "depth.bin"
        with pytest.raises(InputError, match=r"depth\.bin: there is no such depth map"):
            read_colmap_depth(path)
        write_map(path, np.ones((4, 6), np.float32))
        whole = path.read_bytes()
        for content, message in (
            (whole[:-1], r"truncated, or not a depth map of COLMAP \(6 x 4 x 1\)"),
            (whole + b"x", "truncated"),
            (b"0&4&1&", "truncated"),
            (b"2&1&3&" + 24 * b"x", "not a depth map of COLMAP"),
            (b"P6 6 4 255 ", "not a depth map of COLMAP"),
            (b"a&b&c&" + whole, "not a depth map"),
        ):
            path.write_bytes(content)
            with pytest.raises(InputError, match=message):
                read_colmap_depth(path)


class TestConfirmation:
    def test_noise_comes_back_and_outliers_go(self, component: Component) -> None:
        cameras = [blind(camera) for camera in component.cameras]
        partners = stereo_partners(component, count=4, best_angle_deg=14, max_angle_deg=35)
        measured = [erring(camera, k) for k, camera in enumerate(cameras)]
        depths = [np.where(depth > 0, depth, np.nan).astype(np.float32) for depth, _ in measured]
        others = [(cameras[j], depths[j]) for j in partners[4]]
        sigma, n_views = confirmed((cameras[4], depths[4]), others, tolerance_ratio=0.01, noise_px=0.0)
        wrong = measured[4][1]
        assert len(others) == 4 and n_views.max() >= 3
        believed = n_views >= 2
        seen = n_views[40:-40, 60:-60][~wrong[40:-40, 60:-60]]
        # Half of the middle is in view of two partners only, each of which is wrong about a tenth.
        assert 0.7 < np.mean(seen >= 2) < 0.97
        assert np.mean(believed[wrong]) < 0.02
        good = believed & ~wrong & (n_views >= 3)
        error = (depths[4] - true_depth(cameras[4]))[good]
        assert 0.85 < np.sqrt(np.mean(sigma[good] ** 2)) / np.sqrt(np.mean(error**2)) < 1.15
        assert np.isnan(sigma[n_views == 0]).all() and np.isfinite(sigma[n_views > 0]).all()

    def test_what_all_maps_share(self, component: Component) -> None:
        """Exact maps: only the disparity's noise is left, and it is smaller at a larger angle."""
        cameras = [blind(camera) for camera in component.cameras]
        middle = cameras[4].centre
        sigmas = []
        for k in (5, 10):  # 20 m and 40 m away
            one, other = ((camera, true_depth(camera)) for camera in (cameras[4], cameras[k]))
            sigma, n_views = confirmed(one, [other], tolerance_ratio=0.01, noise_px=0.5)
            baseline = float(np.linalg.norm(cameras[k].centre - middle))
            expected = 60.0**2 * 0.5 / (cameras[4].intrinsics.fx * baseline)
            assert (n_views == 1).sum() > 10_000
            sigmas.append(float(np.nanmedian(sigma)))
            assert 0.8 < sigmas[-1] / expected < 1.5
        assert sigmas[0] > 1.5 * sigmas[1]


def blind(camera: Camera) -> Camera:
    """Its pinhole camera."""
    photo = Photos((camera.image,), ((400, 300),), lambda _: np.zeros((300, 400, 3), np.uint8))
    return empty_depth_map(camera, photo, 400).camera


STAND_IN = """#!{python}
import shutil, sys
from pathlib import Path
if sys.argv[1] == "help":
    print("COLMAP 4.2.0 (Commit 0123456 on 2026-01-01 {build})")
    sys.exit()
assert sys.argv[1] == "patch_match_stereo" and sys.argv[4:6] == ["--workspace_format", "COLMAP"], sys.argv
name = "--PatchMatchStereo."
assert sys.argv[6:] == [name + "max_image_size", "400", name + "geom_consistency", "1"], sys.argv
folder = Path(sys.argv[3])
if {fails}:
    print("one line\\nout of memory")
    sys.exit(3)
for path in Path("{maps}").iterdir():
    shutil.copy(path, folder / "stereo/depth_maps")
"""


def stand_in(path: Path, maps: Path, build: str = "with CUDA", *, fails: bool = False) -> str:
    path.write_text(STAND_IN.format(python=sys.executable, maps=maps, build=build, fails=fails))
    path.chmod(0o755)
    return str(path)


class TestEngine:
    @pytest.fixture
    def made(self, component: Component, tmp_path: Path) -> Path:
        folder = tmp_path / "maps"
        folder.mkdir()
        for k, camera in enumerate(component.cameras):
            write_map(folder / f"{k:06d}.ppm.geometric.bin", erring(blind(camera), k)[0])
        return folder

    def test_depth_maps(self, component: Component, photos: Photos, made: Path, tmp_path: Path) -> None:
        steps: list[tuple[int, int]] = []
        engine = PatchMatchDepth(stand_in(tmp_path / "colmap", made), max_px=400, partners=4, noise_px=0.0)
        maps = list(engine(component, photos, progress=lambda done, of, _="": steps.append((done, of))))
        assert [one.camera.image for one in maps] == [camera.image for camera in component.cameras]
        assert steps[-1] == (12, 12)
        for one in maps:
            assert_right(one)

    def test_a_map_of_another_size_or_none(
        self, component: Component, photos: Photos, made: Path, tmp_path: Path
    ) -> None:
        engine = PatchMatchDepth(stand_in(tmp_path / "colmap", made), max_px=400)
        write_map(made / "000003.ppm.geometric.bin", np.ones((3, 4), np.float32))
        with pytest.raises(InputError, match=r"000003\.ppm\.geometric\.bin: 4 x 3 depths for 400 x 300 pixels"):
            list(engine(component, photos))
        (made / "000003.ppm.geometric.bin").unlink()
        with pytest.raises(InputError, match=r"000003.*there is no such depth map"):
            list(engine(component, photos))

    def test_it_fails(self, component: Component, photos: Photos, tmp_path: Path) -> None:
        engine = PatchMatchDepth(stand_in(tmp_path / "colmap", tmp_path, fails=True), max_px=400)
        with pytest.raises(BackendUnavailable, match=r"failed with status 3 \(out of memory\)"):
            list(engine(component, photos))

    def test_builds_without_a_gpu(
        self, component: Component, photos: Photos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for build in ("without CUDA", "without GPU support"):
            engine = PatchMatchDepth(stand_in(tmp_path / "colmap", tmp_path, build))
            with pytest.raises(BackendUnavailable, match="a build of COLMAP that cannot use a GPU"):
                list(engine(component, photos))
        with pytest.raises(InputError, match="nowhere/colmap: there is no such program"):
            list(PatchMatchDepth(str(tmp_path / "nowhere/colmap"))(component, photos))
        monkeypatch.setenv("PATH", str(tmp_path / "empty"))
        monkeypatch.setattr(pycolmap, "has_cuda", False)
        with pytest.raises(BackendUnavailable, match="install COLMAP with CUDA, or use sgm"):
            list(PatchMatchDepth()(component, photos))

    def test_pycolmap_where_it_can(
        self, component: Component, photos: Photos, made: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def run(folder: Path, options: pycolmap.PatchMatchOptions) -> None:
            assert options.max_image_size == 400 and options.geom_consistency
            for path in made.iterdir():
                shutil.copy(path, folder / "stereo/depth_maps")

        monkeypatch.setattr(pycolmap, "has_cuda", True)
        monkeypatch.setattr(pycolmap, "patch_match_stereo", run)
        maps = list(PatchMatchDepth(max_px=400, partners=4, noise_px=0.0)(component, photos))
        assert len(maps) == 12
        assert_right(maps[4])


def assert_right(one: DepthMap) -> None:
    """Dense, with realistic sigmas, and without gross errors."""
    known = np.isfinite(one.depth)
    np.testing.assert_array_equal(known, np.isfinite(one.sigma))
    assert not known[:20].any() and (one.n_views[known] >= 2).all()
    assert 0.2 < known.mean() < 0.95  # a photo in a corner overlaps with few
    error = (one.depth - true_depth(one.camera))[known]
    assert 0.7 * NOISE_RATIO * 60 < np.median(np.abs(error)) * 1.4826 < 1.2 * NOISE_RATIO * 60
    assert np.mean(np.abs(error) > 6 * NOISE_RATIO * 60) < 0.005


def test_the_workspace_is_one_that_colmap_reads(component: Component, photos: Photos, tmp_path: Path) -> None:
    """COLMAP itself, on the CPU, fuses exact depth maps in it to points on the ground."""
    views = [(m.camera, m.rgb) for m in (empty_depth_map(camera, photos, 400) for camera in component.cameras)]
    partners = stereo_partners(component, count=4, best_angle_deg=14, max_angle_deg=35)
    write_workspace(tmp_path / "dense", component, views, partners)
    for k, (camera, _) in enumerate(views):
        stem = f"{k:06d}.ppm.geometric.bin"
        depth = true_depth(camera)
        write_map(tmp_path / "dense/stereo/depth_maps" / stem, depth)
        up = np.broadcast_to(camera.cam_from_world.rotation[:, 2], (*depth.shape, 3)).astype(np.float32)
        write_map(tmp_path / "dense/stereo/normal_maps" / stem, up)
    (tmp_path / "dense/stereo/fusion.cfg").write_text("".join(f"{k:06d}.ppm\n" for k in range(len(views))))
    (tmp_path / "fused").mkdir()
    fused = pycolmap.stereo_fusion(tmp_path / "fused", tmp_path / "dense", input_type="geometric", output_type="bin")
    xyz = np.array([point.xyz for point in fused.points3D.values()])
    assert len(xyz) > 10_000 and np.abs(xyz[:, 2]).max() < 0.05
