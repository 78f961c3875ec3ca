# SPDX-License-Identifier: Apache-2.0
"""The offline default: COLMAP's SIFT on the CPU, matched by brute force and verified."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import pycolmap

from skymoor.reconstruct.pairs import exhaustive_pairs, preemptive_pairs
from skymoor.reconstruct.protocol import PairMatcher, colmap_name
from skymoor.types import Array32, Photos, Progress

T = TypeVar("T")


@dataclass(frozen=True)
class SiftMatcher:
    """COLMAP SIFT (Lowe 2004; RootSIFT normalisation) with exhaustive or preemptive pairs.

    Attributes:
        max_features: per photo; 4096 lose nothing against 8192 on the sets that we measured.
        max_image_px: longer sides are reduced before detection (key points keep the full photo's pixels).
        shared_camera: photos of one size are taken by one camera.
        exhaustive_below: sets of at most this many photos match every pair.
        neighbours: partners per photo in larger sets.
        retrieval_features: of each photo's largest features, for choosing partners.
    """

    max_features: int = 4096
    max_image_px: int = 1600
    shared_camera: bool = True
    exhaustive_below: int = 40
    neighbours: int = 20
    retrieval_features: int = 512
    block_pairs: int = 64

    def __call__(self, photos: Photos, database: Path, folder: Path, *, seed: int, progress: Progress) -> None:
        """Fill `database`; see `PairMatcher`."""
        n = len(photos)
        total = 3 * n  # extraction, choice of partners and matching take about as long
        _write_greyscale(photos, folder)
        self._enter(photos, database)
        self._extract(photos, database, folder, lambda done: progress(done, total))
        pairs = self._pairs(photos, database)
        names = [colmap_name(i, size) for i, size in enumerate(photos.sizes)]
        done = 0
        for block in _blocks(pairs, self.block_pairs):
            self._match(database, folder / "pairs.txt", [(names[i], names[j]) for i, j in block], seed)
            done += len(block)
            progress(n + 2 * n * done // len(pairs), total)

    def _enter(self, photos: Photos, database: Path) -> None:
        """Cameras and images in the order of the photos.

        Extraction would number them as its threads finish, and the mapping's result depends on the numbers.
        """
        # RADIAL for a shared camera: a hundred photos determine a second term, a single photo does not.
        model = "RADIAL" if self.shared_camera else "SIMPLE_RADIAL"
        cameras: dict[tuple[int, int], tuple[int, int]] = {}
        with pycolmap.Database.open(database) as db:
            for index, size in enumerate(photos.sizes):
                if size not in cameras or not self.shared_camera:
                    cameras[size] = _new_camera(db, model, size)
                camera_id, rig_id = cameras[size]
                image_id = db.write_image(pycolmap.Image(name=colmap_name(index, size), camera_id=camera_id))
                frame = pycolmap.Frame(rig_id=rig_id)
                frame.add_data_id(db.read_image(image_id).data_id)
                db.write_frame(frame)

    def _extract(self, photos: Photos, database: Path, folder: Path, report: Callable[[int], None]) -> None:
        options = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=os.cpu_count() or 1)
        options.max_image_size = self.max_image_px
        options.sift.max_num_features = self.max_features
        mode = pycolmap.CameraMode.SINGLE if self.shared_camera else pycolmap.CameraMode.PER_IMAGE
        # RADIAL for a shared camera: a hundred photos determine a second term, a single photo does not.
        reader = pycolmap.ImageReaderOptions(camera_model="RADIAL" if self.shared_camera else "SIMPLE_RADIAL")
        done = 0
        for size in sorted(set(photos.sizes)):
            names = [colmap_name(i, s) for i, s in enumerate(photos.sizes) if s == size]
            for block in _blocks(names, 16):
                pycolmap.extract_features(database, folder, block, mode, reader, options, pycolmap.Device.cpu)
                done += len(block)
                report(done)

    def _pairs(self, photos: Photos, database: Path) -> list[tuple[int, int]]:
        if len(photos) <= self.exhaustive_below:
            return exhaustive_pairs(len(photos))
        with pycolmap.Database.open(database) as db:
            descriptors = [
                _largest(db, colmap_name(i, size), self.retrieval_features) for i, size in enumerate(photos.sizes)
            ]
        return preemptive_pairs(descriptors, neighbours=self.neighbours)

    def _match(self, database: Path, list_file: Path, names: list[tuple[str, str]], seed: int) -> None:
        list_file.write_text("".join(f"{a} {b}\n" for a, b in names))
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = seed
        pycolmap.match_image_pairs(
            database,
            matching_options=pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=os.cpu_count() or 1),
            pairing_options=pycolmap.ImportedPairingOptions(match_list_path=str(list_file)),
            verification_options=verification,
            device=pycolmap.Device.cpu,
        )


_: type[PairMatcher] = SiftMatcher


def _blocks(items: list[T], size: int) -> Iterator[list[T]]:
    for start in range(0, len(items), size):
        yield items[start : start + size]


def _write_greyscale(photos: Photos, folder: Path) -> None:
    """COLMAP reads focal lengths out of EXIF when it can; a PGM has none, and costs little to write."""
    for index, (name, size) in enumerate(zip(photos.names, photos.sizes, strict=True)):
        path = folder / colmap_name(index, size)
        path.parent.mkdir(parents=True, exist_ok=True)
        if not cv2.imwrite(str(path), cv2.cvtColor(photos.read(name), cv2.COLOR_RGB2GRAY)):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))  # OpenCV has no other word for it


def _new_camera(db: pycolmap.Database, model: str, size: tuple[int, int]) -> tuple[int, int]:
    """Numbers of a new camera with COLMAP's usual first guess, and of the rig that holds nothing else."""
    camera = pycolmap.Camera.create_from_model_name(0, model, 1.2 * max(size), *size)
    camera.camera_id = db.write_camera(camera)
    rig = pycolmap.Rig()
    rig.add_ref_sensor(camera.sensor_id)
    return camera.camera_id, db.write_rig(rig)


def _stored(db: pycolmap.Database, name: str) -> pycolmap.Image:
    image = db.read_image_with_name(name)
    if image is None:
        raise LookupError(f"{name} is not in the database")
    return image


def _largest(db: pycolmap.Database, name: str, count: int) -> Array32:
    """Unit descriptors (at most `count`, 128) of an image's largest features."""
    image_id = _stored(db, name).image_id
    affine = db.read_keypoints(image_id)[:, 2:6]
    scale = np.abs(affine[:, 0] * affine[:, 3] - affine[:, 1] * affine[:, 2])
    data = db.read_descriptors(image_id).data[np.argsort(-scale)[:count]].astype(np.float32)
    return np.asarray(data / np.maximum(np.linalg.norm(data, axis=1, keepdims=True), 1e-9))
