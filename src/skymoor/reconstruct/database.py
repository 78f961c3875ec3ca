# SPDX-License-Identifier: Apache-2.0
"""Writing photos, key points and matches of engines to a COLMAP database."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from skymoor.engines.colmap import STOP
from skymoor.reconstruct.pairs import exhaustive_pairs, preemptive_pairs
from skymoor.reconstruct.protocol import colmap_name
from skymoor.types import Array, Array32, Image, Photos

T = TypeVar("T")
Matched = tuple[int, int, NDArray[np.uint32]]

RETRIEVAL_PX = 800
COPIES = 16  # photos that lie on the disk a second time while COLMAP looks for key points


def enter_photos(photos: Photos, database: Path, *, shared_camera: bool) -> None:
    """Cameras and images in the order of the photos.

    Extraction would number them in any order of its threads, and the result of mapping depends on the numbers.
    """
    # RADIAL for a shared camera: a hundred photos determine a second term, a single photo does not.
    model = "RADIAL" if shared_camera else "SIMPLE_RADIAL"
    cameras: dict[tuple[int, int], tuple[int, int]] = {}
    with pycolmap.Database.open(database) as db:
        for index, size in enumerate(photos.sizes):
            if size not in cameras or not shared_camera:
                cameras[size] = new_camera(db, model, size)
            camera_id, rig_id = cameras[size]
            image_id = db.write_image(pycolmap.Image(name=colmap_name(index, size), camera_id=camera_id))
            frame = pycolmap.Frame(rig_id=rig_id)
            frame.add_data_id(db.read_image(image_id).data_id)
            db.write_frame(frame)


def extract(
    photos: Photos,
    database: Path,
    folder: Path,
    options: pycolmap.FeatureExtractionOptions,
    *,
    grey: bool,
    shared_camera: bool,
    report: Callable[[int], None],
) -> None:
    """Key points and descriptors by COLMAP, after `enter_photos`; `report` is called with the number of photos done.

    COLMAP reads files: copies of a few photos at a time lie in `folder`, and no later step needs them. With `grey` they
    are grey, else in colour.
    """
    mode = pycolmap.CameraMode.SINGLE if shared_camera else pycolmap.CameraMode.PER_IMAGE
    reader = pycolmap.ImageReaderOptions(camera_model="RADIAL" if shared_camera else "SIMPLE_RADIAL")
    device = pycolmap.Device.auto if options.use_gpu else pycolmap.Device.cpu
    done = 0
    for size in sorted(set(photos.sizes)):
        for block in blocks([i for i, one in enumerate(photos.sizes) if one == size], COPIES):
            names = [colmap_name(i, size) for i in block]
            for i, name in zip(block, names, strict=True):
                _write_copy(photos.read(photos.names[i]), folder / name, grey=grey)
            pycolmap.extract_features(database, folder, names, mode, reader, options, device, STOP)
            for name in names:
                (folder / name).unlink()
            done += len(block)
            report(done)


def _write_copy(rgb: Image, path: Path, *, grey: bool) -> None:
    """A photo as a file without EXIF, from which COLMAP would read a focal length.

    In colour it has the same name: COLMAP detects the format by content.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    code = cv2.COLOR_RGB2GRAY if grey else cv2.COLOR_RGB2BGR
    _, content = cv2.imencode(".pgm" if grey else ".ppm", cv2.cvtColor(rgb, code))
    path.write_bytes(content.tobytes())


def match(
    photos: Photos,
    database: Path,
    folder: Path,
    pairs: Sequence[tuple[int, int]],
    options: pycolmap.FeatureMatchingOptions,
    *,
    block_pairs: int,
    seed: int,
    report: Callable[[int], None],
) -> None:
    """Match and verify pairs by COLMAP, `block_pairs` at a time; `report` is called with the number done."""
    names = [colmap_name(i, size) for i, size in enumerate(photos.sizes)]
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    done = 0
    for block in blocks(pairs, block_pairs):
        list_file = folder / "pairs.txt"
        list_file.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in block))
        pycolmap.match_image_pairs(
            database,
            matching_options=options,
            pairing_options=pycolmap.ImportedPairingOptions(match_list_path=str(list_file)),
            verification_options=verification,
            device=pycolmap.Device.auto if options.use_gpu else pycolmap.Device.cpu,
            cancellation_token=STOP,
        )
        done += len(block)
        report(done)


def write_verified(
    photos: Photos,
    database: Path,
    folder: Path,
    keypoints: Sequence[Array],
    matched: Iterable[Matched],
    *,
    min_matches: int,
    pixel_px: float,
    seed: int,
) -> None:
    """Write key points and matches of another engine, and verify the matches by epipolar geometry.

    Args:
        photos, database: after `enter_photos`.
        folder: for a temporary file.
        keypoints: (n, 2) pixels of each photo.
        matched: photo numbers and rows (m, 2) of their key points.
        min_matches: pairs with fewer are not verified.
        pixel_px: size of a detector pixel in photo pixels, where photos were reduced.
        seed: of RANSAC.
    """
    names = [colmap_name(k, size) for k, size in enumerate(photos.sizes)]
    pairs = []
    with pycolmap.Database.open(database) as db:
        ids = [stored(db, name).image_id for name in names]
        for image_id, px in zip(ids, keypoints, strict=True):
            db.write_keypoints(image_id, px.astype(np.float32))
        for i, j, index in matched:
            if len(index) >= min_matches:
                db.write_matches(ids[i], ids[j], index)
                pairs.append(f"{names[i]} {names[j]}\n")
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    # Key points are as accurate as the pixels of the reduced photo.
    verification.ransac.max_error = max(verification.ransac.max_error, 2 * pixel_px)
    if pairs:
        (folder / "pairs.txt").write_text("".join(pairs))
        pycolmap.verify_matches(database, folder / "pairs.txt", verification, cancellation_token=STOP)


def coarsest_px(photos: Photos, side_px: int) -> float:
    """Photo pixels per pixel of the largest photo reduced to a long side of `side_px`."""
    return max(1.0, max((max(size) for size in photos.sizes), default=0) / side_px)


def likely_pairs(photos: Photos, *, exhaustive_below: int, neighbours: int) -> list[tuple[int, int]]:
    """All pairs of a small set; of a larger one those with similar large SIFT features."""
    if len(photos) <= exhaustive_below:
        return exhaustive_pairs(len(photos))
    return preemptive_pairs([_largest(photos.read(name)) for name in photos.names], neighbours=neighbours)


def stored(db: pycolmap.Database, name: str) -> pycolmap.Image:
    """The image of that name. Raises `LookupError` if there is none."""
    image = db.read_image_with_name(name)
    if image is None:
        raise LookupError(f"{name} is not in the database")
    return image


def threads() -> int:
    """Threads for COLMAP: the number of processors."""
    return os.cpu_count() or 1


def blocks(items: Sequence[T], size: int) -> Iterator[Sequence[T]]:
    """The items in blocks of `size`, between which progress is reported."""
    for start in range(0, len(items), size):
        yield items[start : start + size]


def new_camera(db: pycolmap.Database, model: str, size: tuple[int, int]) -> tuple[int, int]:
    """Ids of a new camera with COLMAP's default intrinsics, and of the rig of this camera alone."""
    camera = pycolmap.Camera.create_from_model_name(0, model, 1.2 * max(size), *size)
    camera.camera_id = db.write_camera(camera)
    rig = pycolmap.Rig()
    rig.add_ref_sensor(camera.sensor_id)
    return camera.camera_id, db.write_rig(rig)


def _largest(image: Image, count: int = 512) -> Array32:
    """Unit descriptors (at most `count`, 128) of a photo's largest SIFT features."""
    ratio = min(1.0, RETRIEVAL_PX / max(image.shape[:2]))
    grey = cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), None, fx=ratio, fy=ratio, interpolation=cv2.INTER_AREA)
    points, descriptors = cv2.SIFT.create(nfeatures=4 * count).detectAndCompute(grey, None)
    if descriptors is None or not len(points):
        return np.zeros((0, 128), np.float32)
    largest = np.argsort([-point.size for point in points], kind="stable")[:count]
    root = np.sqrt(descriptors[largest] / np.maximum(descriptors[largest].sum(axis=1, keepdims=True), 1e-9))
    return np.asarray(root, np.float32)
