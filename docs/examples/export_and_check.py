# SPDX-License-Identifier: Apache-2.0
"""Export a run for nerfstudio and COLMAP, and check that both agree: export_and_check.py RESULT FOLDER.

Every point of COLMAP's model is projected with nerfstudio's cameras, and compared with its observation in the photo.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pycolmap

import skymoor
from skymoor.results.export import export


def main(run: Path, folder: Path) -> float:
    """Exports go to FOLDER/nerfstudio and FOLDER/colmap; returns the median distance in pixels."""
    export(skymoor.read(run), ["nerfstudio,colmap"], folder, print)
    frames = json.loads((folder / "nerfstudio" / "transforms.json").read_text(encoding="utf-8"))["frames"]
    by_photo = {Path(frame["file_path"]).name: frame for frame in frames}
    distances = []
    for model in sorted((folder / "colmap" / "bin").iterdir()):
        if not model.is_dir():
            continue
        scene = pycolmap.Reconstruction(model)
        for image in scene.images.values():
            seen = [point for point in image.points2D if point.has_point3D()]
            xyz = np.array([scene.points3D[point.point3D_id].xyz for point in seen])
            px = projected(xyz, by_photo[Path(image.name).name])
            distances.extend(np.linalg.norm(px - [point.xy for point in seen], axis=1))
    median = float(np.median(distances))
    print(f"{len(distances)} observations in {len(frames)} photos, half of them within {median:.2f} pixels")
    return median


def projected(xyz: np.ndarray, frame: dict) -> np.ndarray:
    """Pixels (n, 2) of points (n, 3) in metres of the site, by OpenGL's axes and OpenCV's distortion model."""
    world_from_cam = np.array(frame["transform_matrix"])
    cam = (xyz - world_from_cam[:3, 3]) @ world_from_cam[:3, :3] * [1.0, -1.0, -1.0]
    x, y = (cam[:, :2] / cam[:, 2:]).T
    k1, k2, p1, p2 = (frame[name] for name in ("k1", "k2", "p1", "p2"))
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.column_stack([frame["fl_x"] * u + frame["cx"], frame["fl_y"] * v + frame["cy"]])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
