# SPDX-License-Identifier: Apache-2.0
"""Pairs in the layout of the SRIF data set, of drawn blocks."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

SHAPE = (100, 120)


def write_pair(folder: Path, kind: str, name: str, azimuth_deg: float, scale: float) -> Path:
    """An image, and a noisy negative of it, turned and scaled about the middle, black beyond; returns its folder."""
    rng = np.random.default_rng(int(name))
    h, w = SHAPE
    a = np.full(SHAPE, 120, np.uint8)
    for _ in range(40):
        corner = rng.uniform(0, [w, h], 2)
        box = (corner.tolist(), rng.uniform(8, 34, 2).tolist(), float(rng.uniform(0, 90)))
        cv2.fillPoly(a, [cv2.boxPoints(box).astype(np.int32)], int(rng.integers(40, 220)))
    turn = np.radians(azimuth_deg)
    linear = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    middle = np.array([(w - 1) / 2, (h - 1) / 2])
    b_from_a = np.column_stack([linear, middle - linear @ middle + [4.3, -2.6]])
    b = 255 - cv2.warpAffine(a, b_from_a, (w, h), flags=cv2.INTER_LINEAR, borderValue=255)
    b = np.where(b > 0, np.clip(b + rng.normal(0, 6, SHAPE), 20, 255), 0).astype(np.uint8)
    target = folder / kind
    target.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(target / f"pair{name}_1.png"), a)
    cv2.imwrite(str(target / f"pair{name}_2.png"), b)
    np.savetxt(target / f"gt_{name}.txt", b_from_a)
    return target
