# SPDX-License-Identifier: Apache-2.0
"""Registration of point clouds by others, in metres: Open3D's FPFH with RANSAC, and KISS-Matcher where it is installed.

KISS-Matcher (Lim et al. 2024) is not in skymoor's environment. `python cloud_peers.py FILE.npz`, run by the Python of
an environment that has it, reads `source`, `target` (n, 3) and `voxel`, and writes the answer to FILE.json.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NORMALS, FEATURES, NEAR = 2.0, 5.0, 1.5  # radii and distance in voxels, as Open3D's tutorial has them


def fpfh_target(target: Array, voxel: float) -> tuple[Any, Any]:
    """The cloud reduced to voxels, and its features: computed once per reference."""
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(target)).voxel_down_sample(voxel)
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamHybrid(NORMALS * voxel, 30))
    cloud.orient_normals_to_align_with_direction([0.0, 0.0, 1.0])
    around = open3d.geometry.KDTreeSearchParamHybrid(FEATURES * voxel, 100)
    return cloud, open3d.pipelines.registration.compute_fpfh_feature(cloud, around)


def fpfh_ransac(source: Array, prepared: tuple[Any, Any], voxel: float) -> tuple[Array, float]:
    """(4, 4) target from source, and the share of the source that fits it."""
    import open3d

    registration = open3d.pipelines.registration
    open3d.utility.random.seed(0)
    cloud, features = fpfh_target(source, voxel)
    near, mutual, with_scale = NEAR * voxel, True, False
    found = registration.registration_ransac_based_on_feature_matching(
        cloud,
        prepared[0],
        features,
        prepared[1],
        mutual,
        near,
        registration.TransformationEstimationPointToPoint(with_scale),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(near),
        ],
        registration.RANSACConvergenceCriteria(100000, 0.999),
    )
    return np.array(found.transformation), float(found.fitness)


def kiss(source: Array, target: Array, voxel: float, python: Path) -> tuple[Array, float, float]:
    """(4, 4) target from source, inliers, and CPU seconds, from another environment."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "clouds.npz"
        np.savez(file, source=source, target=target, voxel=voxel)
        subprocess.run([python, __file__, file], capture_output=True, check=True)
        found = json.loads(file.with_suffix(".json").read_text())
    return np.array(found["target_from_source"]), found["inliers"], found["cpu_s"]


def main() -> None:
    import kiss_matcher

    clouds = np.load(sys.argv[1])
    start = time.process_time()
    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(float(clouds["voxel"])))
    found = matcher.estimate(clouds["source"].astype(np.float32), clouds["target"].astype(np.float32))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = found.rotation, np.ravel(found.translation)
    answer = {
        "target_from_source": matrix.tolist(),
        "inliers": matcher.get_num_final_inliers(),
        "cpu_s": time.process_time() - start,
    }
    Path(sys.argv[1]).with_suffix(".json").write_text(json.dumps(answer))


if __name__ == "__main__":
    main()
