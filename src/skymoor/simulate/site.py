# SPDX-License-Identifier: Apache-2.0
"""A simulated site as files: what a user has, and the truth that a user has not."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from skymoor.errors import InputError
from skymoor.geo import EnuFrame
from skymoor.geometry import Intrinsics, Similarity, umeyama
from skymoor.simulate.capture.carriers import carrier_of
from skymoor.simulate.capture.shots import Shot, airborne_shots, ground_shots, security_shots
from skymoor.simulate.light.photo import take_photo, true_depth, true_labels
from skymoor.simulate.mesh import stream
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.plan import Date, dates_of, place_of
from skymoor.simulate.satellite import covariance_of, draw_bias, make_reference
from skymoor.simulate.world import World
from skymoor.types import Camera, Component, Progress, no_progress

Array = NDArray[np.float64]

SCRATCH = ".unfinished"  # within the site's folder, where files are written before they get their place
REFERENCE = ("reference/ortho.tif", "reference/dsm.tif")
CAMERA_COLUMNS = (
    *("name", "set", "group", "width", "height", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    *("lat", "lon", "h_ell_m", "east", "north", "up", "qw", "qx", "qy", "qz"),
)


@dataclass(frozen=True, eq=False)
class Site:
    """A simulated site on the disk.

    `frame` is what the truth's ENU coordinates are in; `bias_m` (3,) east-north-up is by how much the reference is
    off, `covariance` (3, 3) in m^2 what that was drawn from and what site.toml states.
    """

    folder: Path
    frame: EnuFrame
    bias_m: Array
    covariance: Array

    @property
    def toml(self) -> Path:
        """The file to give to a run."""
        return self.folder / "site.toml"

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """True cameras in `frame`, by the photo's name."""
        with (self.folder / "truth_cameras.csv").open(encoding="utf-8", newline="") as file:
            return {row["name"]: _camera_of(row) for row in csv.DictReader(file)}


def write_site(world: World, folder: Path, *, progress: Progress = no_progress) -> Site:
    """Write photos, reference, site.toml and truth into `folder`; files that are there already are kept.

    Raises `InputError` when the folder holds something else, and when the options ask for more than fits on the site.
    """
    options = world.options
    covariance = covariance_of(options)
    # Rounded as it is written, so that a site read again is the same.
    bias_m = np.round(draw_bias(covariance, stream(options.key, "bias")), 6)
    site = Site(folder, place_of(options), bias_m, covariance)
    _claim(world, site)
    if _complete(site):
        progress(1, 1)
        return site
    shots = [*airborne_shots(world), *ground_shots(world), *security_shots(world)]
    _once(site, "truth.csv", lambda path: path.write_text(_truth_csv(site, shots), encoding="utf-8"))
    _once(site, "truth_cameras.csv", lambda path: path.write_text(_cameras_csv(site, shots), encoding="utf-8"))
    if world.options.real:
        _once(site, "truth_photos.csv", lambda path: path.write_text(_photos_csv(shots), encoding="utf-8"))
    for done, shot in enumerate(shots):
        progress(done, len(shots) + 2)
        _write_photo(world, site, shot)
    _write_reference(world, site, lambda done: progress(len(shots) + done, len(shots) + 2))
    # Last: what has a site.toml was complete once.
    _once(site, site.toml.name, lambda path: path.write_text(_toml(world, site), encoding="utf-8"))
    shutil.rmtree(folder / SCRATCH, ignore_errors=True)
    return site


def true_enu_from_sfm(component: Component, cameras_enu: Iterable[Camera]) -> Similarity:
    """The similarity that best lays a component's cameras on the true ones of the same names.

    Raises `TooFewMatches` below three cameras in common, `DegenerateGeometry` when they stand in a line.
    """
    centres = {camera.image: camera.centre for camera in cameras_enu}
    known = [camera for camera in component.cameras if camera.image in centres]
    source = np.array([camera.centre for camera in known]).reshape(-1, 3)
    return umeyama(source, np.array([centres[camera.image] for camera in known]).reshape(-1, 3))


def _claim(world: World, site: Site) -> None:
    """Say whose folder this is, or that it is another's."""
    truth = site.folder / "truth.json"
    ours = json.loads(json.dumps(_truth(world, site)))
    if truth.exists():
        try:
            found = json.loads(truth.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            found = {}
        if not isinstance(found, dict) or found.get("options") != ours["options"]:
            raise InputError(f"{site.folder}: holds a site of other options; give another folder, or delete this one")
        return
    ours_too = ("site.toml", "airborne", *_ground_folders(world.options), "reference", "truth.csv")
    if any((site.folder / name).exists() for name in ours_too):
        raise InputError(f"{site.folder}: holds a site that was not simulated; give another folder")
    _once(site, truth.name, lambda path: path.write_text(json.dumps(ours, indent=1) + "\n", encoding="utf-8"))


def _complete(site: Site) -> bool:
    """Whether everything is there; to see that, nothing needs to be built."""
    if not site.toml.exists() or not (site.folder / "truth_cameras.csv").exists():
        return False
    return all((site.folder / name).exists() for name in ("truth.csv", *REFERENCE, *site.cameras))


def _truth(world: World, site: Site) -> dict[str, object]:
    frame, options = site.frame, world.options
    truth: dict[str, object] = {
        "options": options.written,
        "seed": options.seed,
        "enu_origin": {"lat": frame.lat_deg, "lon": frame.lon_deg, "height": frame.height_m},
        "bias_m": site.bias_m.tolist(),
        "covariance": site.covariance.tolist(),
        "dates": asdict(dates_of(options)),
    }
    if options.real:
        groups = range(options.groups)
        truth["groups"] = {chr(ord("a") + group): asdict(carrier_of(options, group)) for group in groups}
    return truth


def _write_photo(world: World, site: Site, shot: Shot) -> None:
    options, camera = world.options, shot.camera
    dates = dates_of(options)
    date: Date = getattr(dates, shot.set)
    stem = camera.image.removesuffix(".jpg")

    def photo(path: Path) -> None:
        rng = stream(options.key, "photo", camera.image)
        pixels = take_photo(world.scene(date), camera, shot.sensor, rng, samples=options.samples, motion=shot.motion)
        PillowImage.fromarray(pixels).save(path, format="JPEG", quality=shot.sensor.quality)

    def depth(path: Path) -> None:
        with path.open("wb") as file:
            np.savez_compressed(file, depth=true_depth(world.scene(date), camera))

    def labels(path: Path) -> None:
        PillowImage.fromarray(true_labels(world.scene(date), camera)).save(path, format="PNG")

    _once(site, camera.image, photo)
    if options.depths:
        _once(site, f"truth_depth/{stem}.npz", depth)
    if options.labels:
        _once(site, f"truth_labels/{stem}.png", labels)


def _write_reference(world: World, site: Site, report: Callable[[int], None]) -> None:
    report(0)
    if not all((site.folder / name).exists() for name in REFERENCE):
        scene = world.scene(dates_of(world.options).satellite)
        reference = make_reference(world, scene, site.bias_m, stream(world.options.key, "reference"))
        report(1)
        _once(site, REFERENCE[0], reference.write_ortho)
        _once(site, REFERENCE[1], reference.write_dsm)
    report(2)


def _once(site: Site, name: str, write: Callable[[Path], object]) -> None:
    """Write a file elsewhere, then move it to its place: a file that is there is whole, and is kept."""
    target, fresh = site.folder / name, site.folder / SCRATCH / Path(name).name
    if target.exists():
        return
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        fresh.parent.mkdir(exist_ok=True)
        write(fresh)
        fresh.replace(target)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror or error}") from error


def _toml(world: World, site: Site) -> str:
    options = world.options
    rows = ", ".join("[" + ", ".join(repr(float(x)) for x in row) + "]" for row in site.covariance)
    text = (
        f'name = "simulated {options.preset}, seed {options.seed}"\n\n[reference]\northo = "reference/ortho.tif"\n'
        f'dsm = "reference/dsm.tif"\nvertical_datum = "ellipsoid"\ncovariance = [{rows}]  # m^2, east-north-up\n'
    )
    if options.airborne:
        text += '\n[airborne]\nimages = "airborne"\n'
    return text + "".join(f'\n[[ground]]\nimages = "{folder}"\n' for folder in _ground_folders(options))


def _ground_folders(options: SiteOptions) -> list[str]:
    """Where ground photos are: under real conditions each group has a folder of its own."""
    groups = [f"ground_{chr(ord('a') + group)}" for group in range(options.groups)] if options.real else []
    shared = options.security or (options.groups and not options.real)
    return [*groups, *(["ground"] if shared else [])]


def _truth_csv(site: Site, shots: Sequence[Shot]) -> str:
    lla = site.frame.lla_from_enu([shot.camera.centre for shot in shots])
    rows = [[shot.camera.image, *(repr(float(x)) for x in place)] for shot, place in zip(shots, lla, strict=True)]
    return _table(["image", "lat", "lon", "height"], rows)


def _cameras_csv(site: Site, shots: Sequence[Shot]) -> str:
    lla = site.frame.lla_from_enu([shot.camera.centre for shot in shots])
    rows = []
    for shot, place in zip(shots, lla, strict=True):
        i, pose = shot.camera.intrinsics, shot.camera.cam_from_world
        lens = (i.width, i.height, i.fx, i.fy, i.cx, i.cy, *i.distortion)
        numbers = (*lens, *place.tolist(), *shot.camera.centre.tolist(), *pose.quaternion_wxyz.tolist())
        rows.append([shot.camera.image, shot.set, shot.group, *(repr(x) for x in numbers)])
    return _table(CAMERA_COLUMNS, rows)


def _photos_csv(shots: Sequence[Shot]) -> str:
    """How the ground photos of groups were taken: piece of the walk, blur, readout, quality."""
    rows = [
        [
            s.camera.image,
            *map(repr, (s.piece, s.motion.blur_px, s.motion.readout_s, s.sensor.blur_px, s.sensor.quality)),
        ]
        for s in shots
        if s.set == "ground" and s.group != "security"
    ]
    return _table(["image", "piece", "motion_blur_px", "readout_s", "defocus_px", "jpeg_quality"], rows)


def _table(header: Sequence[str], rows: Sequence[list[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *sorted(rows)])
    return text.getvalue()


def _camera_of(row: dict[str, str]) -> Camera:
    k1, k2, p1, p2 = (float(row[name]) for name in ("k1", "k2", "p1", "p2"))
    fx, fy, cx, cy = (float(row[name]) for name in ("fx", "fy", "cx", "cy"))
    lens = Intrinsics(int(row["width"]), int(row["height"]), fx, fy, cx, cy, (k1, k2, p1, p2))
    turned = Similarity.from_quaternion_wxyz(1.0, [float(row[name]) for name in ("qw", "qx", "qy", "qz")], np.zeros(3))
    centre = np.array([float(row[name]) for name in ("east", "north", "up")])
    return Camera(row["name"], lens, Similarity(1.0, turned.rotation, -turned.rotation @ centre))
