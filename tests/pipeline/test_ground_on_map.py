# SPDX-License-Identifier: Apache-2.0
"""A run of ground photos alone: each component is placed on the reference or refused, and all products are there."""

from __future__ import annotations

from pathlib import Path

import pytest

from skymoor.simulate.site import Site
from support.small_run import rows_of, run, summary_of


@pytest.mark.e2e
def test_a_site_without_airborne_photos(small_site: Site, tmp_path: Path) -> None:
    out = tmp_path / "out"
    status = run(small_site.folder / "ground.toml", out)
    (found,) = summary_of(out)["sets"]
    assert found["set"] == "ground0" and found["components"]
    placed = [one for one in found["components"] if one["status"] == "REGISTERED"]
    assert status == (0 if len(placed) == len(found["components"]) else 3)
    for one in found["components"]:
        assert one["criteria"][-1]["kind"] == "chance_of_lead"
        assert one["heights"] in (None, "OFFSET_ONLY")
        assert (out / f"matches/ground0_{one['component']}_plan.png").exists()
    rows = rows_of(out / "cameras.csv")
    assert len(rows) == len(list((small_site.folder / "ground").glob("*.jpg")))
    assert (out / "report.html").stat().st_size > 10_000
