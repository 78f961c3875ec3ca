# SPDX-License-Identifier: Apache-2.0
"""A simulated site is what a user would have, its truth fits it, and writing it can be stopped and continued."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image as PillowImage
from scipy.spatial.transform import Rotation

from skymoor.errors import InputError, TooFewMatches
from skymoor.geo import mahalanobis
from skymoor.geometry import Similarity
from skymoor.pipeline.site import load_site
from skymoor.reference.read import read_reference
from skymoor.results.tables import read_truth_csv
from skymoor.simulate import site as site_module
from skymoor.simulate.capture.shots import airborne_shots, ground_shots, security_shots
from skymoor.simulate.light import photo as photo_module
from skymoor.simulate.mesh import Label
from skymoor.simulate.plan import place_of
from skymoor.simulate.site import Site, true_enu_from_sfm, write_site
from skymoor.simulate.world import World
from skymoor.types import Component
from support.comparators import assert_similarity_near

Array = NDArray[np.float64]
MakeWorld = Callable[..., World]


@pytest.fixture(scope="module")
def truth_world(make_world: MakeWorld) -> World:
    return make_world(depths=True, labels=True)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, truth_world: World) -> Site:
    """Do not write into it."""
    return write_site(truth_world, tmp_path_factory.mktemp("simulated") / "site")


def tiny(make_world: MakeWorld) -> World:
    return make_world(airborne=3, groups=0, security=0, photo_width=24, reference_width_m=30.0)


def contents(folder: Path) -> dict[str, tuple[bytes, int]]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_mtime_ns) for path in files}


def test_a_run_can_read_it(site: Site, truth_world: World) -> None:
    read = load_site(site.toml)
    assert read.airborne == (site.folder / "airborne",) and read.ground == ((site.folder / "ground",),)
    np.testing.assert_allclose(read.reference.covariance, site.covariance, rtol=1e-12)
    reference = read_reference(
        read.reference.ortho, read.reference.dsm, read.reference.vertical_datum, read.reference.covariance
    )
    assert np.isfinite(reference.height).mean() > 0.9 and reference.mask.mean() > 0.9
    here = place_of(truth_world.options).enu_from_lla(*np.array([reference.frame.lat_deg, reference.frame.lon_deg, 0]))
    assert np.linalg.norm(here[0, :2]) < 30
    assert mahalanobis(site.bias_m, site.covariance)[0] < 4


def test_photos_are_bare_and_listed(site: Site, truth_world: World) -> None:
    names = [truth.image for truth in read_truth_csv(site.folder / "truth.csv")]
    files = [
        str(path.relative_to(site.folder))
        for folder in ("airborne", "ground")
        for path in (site.folder / folder).iterdir()
    ]
    assert sorted(files) == sorted(names) == sorted(site.cameras)
    assert len(names) == 6 + 2 * 4 + 2
    for name in names:
        with PillowImage.open(site.folder / name) as photo:
            assert (
                photo.size == (80, 60)
                and not photo.getexif()
                and set(photo.info) <= {"jfif", "jfif_version", "jfif_unit", "jfif_density"}
            )
            assert np.asarray(photo).std() > 8


def test_the_truth_tables_agree_with_the_cameras(site: Site, truth_world: World) -> None:
    truths = {truth.image: truth for truth in read_truth_csv(site.folder / "truth.csv")}
    shots = [*airborne_shots(truth_world), *ground_shots(truth_world), *security_shots(truth_world)]
    for shot in shots:
        name, read = shot.camera.image, site.cameras[shot.camera.image]
        assert read.intrinsics == shot.camera.intrinsics
        assert_similarity_near(read.cam_from_world, shot.camera.cam_from_world, rot_deg=1e-9, trans_m=1e-9, scale_ppm=0)
        t = truths[name]
        enu = place_of(truth_world.options).enu_from_lla(t.lat, t.lon, t.height)[0]
        np.testing.assert_allclose(enu, shot.camera.centre, atol=1e-5)


def test_depths_lead_to_the_dsm_minus_its_bias(site: Site) -> None:
    read = load_site(site.toml).reference
    reference = read_reference(read.ortho, read.dsm, read.vertical_datum, read.covariance)
    errors = []
    for name in (name for name in site.cameras if name.startswith("airborne")):
        camera = site.cameras[name]
        depth = np.load((site.folder / "truth_depth" / name).with_suffix(".npz"))["depth"]
        labels = np.asarray(PillowImage.open((site.folder / "truth_labels" / name).with_suffix(".png")))
        rows, columns = np.nonzero((labels == Label.GROUND) & np.isfinite(depth))
        rays = camera.intrinsics.rays(np.column_stack([columns, rows]) + 0.5) * depth[rows, columns, None]
        shown = camera.cam_from_world.inverse().apply(rays) + site.bias_m
        lla = site.frame.lla_from_enu(shown)
        theirs = reference.frame.enu_from_lla(*lla.T)
        px = reference.grid.px_from_enu(theirs[:, :2])
        inside = (px >= 0).all(axis=1) & (px < reference.grid.shape[::-1]).all(axis=1)
        u, v = px[inside].astype(int).T
        errors.append(reference.height[v, u] - theirs[inside, 2])
    error = np.concatenate(errors)
    error = error[np.isfinite(error)]
    assert len(error) > 3000
    assert np.median(error) == pytest.approx(0, abs=0.06)
    assert 0.1 < 1.4826 * np.median(np.abs(error)) < 0.4


def test_truth_json_says_how_it_was_made(site: Site, truth_world: World) -> None:
    truth = json.loads((site.folder / "truth.json").read_text())
    assert truth["options"]["airborne"] == 6 and truth["options"]["preset"] == "office-park"
    assert truth["bias_m"] == site.bias_m.tolist() and truth["seed"] == truth_world.options.seed
    assert set(truth["dates"]) == {"airborne", "ground", "satellite"}
    assert truth["enu_origin"]["lat"] == place_of(truth_world.options).lat_deg


def test_what_is_missing_is_made_again_as_it_was(tmp_path: Path, make_world: MakeWorld) -> None:
    world, steps = tiny(make_world), []
    write_site(world, tmp_path / "s", progress=lambda done, total: steps.append((done, total)))
    assert steps == sorted(steps) and steps[-1] == (5, 5)
    before = contents(tmp_path / "s")
    for name in ("airborne/air_001.jpg", "reference/dsm.tif"):
        (tmp_path / "s" / name).unlink()
    write_site(world, tmp_path / "s")
    after = contents(tmp_path / "s")
    assert {name: data for name, (data, _) in after.items()} == {name: data for name, (data, _) in before.items()}
    made = {name for name in after if after[name][1] != before[name][1]}
    assert made == {"airborne/air_001.jpg", "reference/dsm.tif"}


def test_a_crash_leaves_whole_files_only(
    tmp_path: Path, make_world: MakeWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, calls = tiny(make_world), []
    take_photo = photo_module.take_photo

    def failing(*args: object, **options: object) -> object:
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return take_photo(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(site_module, "take_photo", failing)
    with pytest.raises(KeyboardInterrupt):
        write_site(world, tmp_path / "s")
    assert [path.name for path in (tmp_path / "s" / "airborne").iterdir()] == ["air_000.jpg"]
    assert not (tmp_path / "s" / "site.toml").exists()
    write_site(world, tmp_path / "s")
    assert len(calls) == 4 and len(list((tmp_path / "s" / "airborne").iterdir())) == 3
    assert not list((tmp_path / "s").glob(".*"))


def test_a_finished_site_is_not_looked_at_again(
    site: Site, truth_world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(truth_world), "scene", None)
    again = write_site(truth_world, site.folder)
    np.testing.assert_array_equal(again.bias_m, site.bias_m)
    assert again.cameras.keys() == site.cameras.keys()


def test_another_site_is_not_written_over(tmp_path: Path, make_world: MakeWorld, site: Site) -> None:
    with pytest.raises(InputError, match=r"other options; give another folder") as refused:
        write_site(make_world(seed=8), site.folder)
    assert str(site.folder) in str(refused.value) and "\n" not in str(refused.value)
    (tmp_path / "site.toml").write_text("name = 'mine'\n")
    with pytest.raises(InputError, match="not simulated"):
        write_site(make_world(), tmp_path)
    assert (tmp_path / "site.toml").read_text() == "name = 'mine'\n"
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_site(make_world(), tmp_path / "file" / "site")


def test_sets_that_were_not_asked_for_are_not_listed(tmp_path: Path, make_world: MakeWorld) -> None:
    site = write_site(tiny(make_world), tmp_path)
    assert load_site(site.toml).ground == () and not (tmp_path / "ground").exists()


def test_the_true_similarity_comes_back(site: Site, rng: np.random.Generator) -> None:
    true = Similarity(3.7, Rotation.random(rng=rng).as_matrix(), np.array([40.0, -7.0, 12.0]))
    cameras = [camera for name, camera in site.cameras.items() if name.startswith("airborne")]
    moved = tuple(camera.transformed(true.inverse()) for camera in cameras)
    nothing = np.zeros(0, np.int32)
    component = Component(moved, np.zeros((0, 3)), np.zeros((0, 3), np.uint8), nothing, nothing, np.zeros((0, 2)), 0.0)
    found = true_enu_from_sfm(component, site.cameras.values())
    assert_similarity_near(found, true, rot_deg=1e-6, trans_m=1e-6, scale_ppm=0.01)
    with pytest.raises(TooFewMatches):
        true_enu_from_sfm(component, cameras[:2])
