# SPDX-License-Identifier: Apache-2.0
"""A refused run with a render and two places that came into question, made up in a moment."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from support.finished import finished_run

PIXEL = 1 / 12  # level units; at a flying height of 12 m one pixel of the render is one metre
FIRST = ("air/001.jpg", 10.0)


def refused_run(folder: Path, *, registered_beside: bool = False) -> Path:
    """Write it; returns its folder. Its render has 80 by 80 pixels, of which a disc of radius 30 shows something."""
    run = finished_run(folder, registered=False)
    u, v = np.meshgrid(np.arange(80) + 0.5, np.arange(80) + 0.5)
    xyz = np.stack([(u - 40) * PIXEL, (40 - v) * PIXEL, np.zeros_like(u)], axis=-1).astype(np.float32)
    xyz[np.hypot(u - 40, v - 40) > 30] = np.nan
    np.savez(run / "renders/airborne_0_nadir.npz", xyz=xyz)
    summary = json.loads((run / "summary.json").read_text())
    component = summary["sets"][0]["components"][0]
    other = {"east": -10.0, "north": 12.0, "lat": 48.0001, "lon": 10.9999, "azimuth_deg": 60.0, "score": 85.0}
    first = component["hypotheses"][0]
    component["hypotheses"] = [first, first | other]
    component["first_photo"] = {"image": FIRST[0], "azimuth_deg": FIRST[1]}
    if registered_beside:
        beside = component | {"component": 1, "status": "REGISTERED", "reason": ""}
        summary["sets"][0]["components"].append(beside)
    (run / "summary.json").write_text(json.dumps(summary))
    return run
