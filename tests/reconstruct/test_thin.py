# SPDX-License-Identifier: Apache-2.0
"""The calibration of a large block rests on as many tracks in each photo as that of a small one."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from skymoor.reconstruct.calibration import TRACKS, TRACKS_PER_PHOTO, thin


@pytest.mark.parametrize(("photos", "kept"), [(20, TRACKS), (160, 160 * TRACKS_PER_PHOTO)])
def test_tracks_grow_with_the_photos(photos: int, kept: int) -> None:
    pycolmap.set_random_seed(2)
    made = pycolmap.synthesize_dataset(
        pycolmap.SyntheticDatasetOptions(
            num_rigs=1, num_cameras_per_rig=1, num_frames_per_rig=photos, num_points3D=5000, track_length=6
        )
    )
    assert len(thin(made).points3D) == kept
    assert len(thin(made, 100).points3D) == 100
    lengths = [point.track.length() for point in thin(made, 100).points3D.values()]
    assert min(lengths) >= np.median([point.track.length() for point in made.points3D.values()])  # the longest
