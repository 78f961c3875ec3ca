# SPDX-License-Identifier: Apache-2.0
"""The files of a reference with their accuracy: as a user states them, or those that an earlier run left."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skymoor.engines.regular import regular
from skymoor.errors import InputError
from skymoor.geo import UNKNOWN_ACCURACY, checked_covariance

Array = NDArray[np.float64]

RIGHTS = ("licence", "credit", "date")


@dataclass(frozen=True, eq=False)
class ReferenceFiles:
    """Orthophoto and DSM; `covariance` (3, 3) m^2 east-north-up is their absolute accuracy, or
    `UNKNOWN_ACCURACY`.

    In place of a DSM there may be one height of the ground in metres, or None where heights are not known.
    `vertical_datum` is "ellipsoid", an EPSG code, or None where the user did not say. `licence`, `credit` and `date`
    are text about both. `run` is the folder of the earlier run whose products they are.
    """

    ortho: Path
    dsm: Path | float | None
    vertical_datum: str | None
    covariance: Array
    licence: str | None = None
    credit: str | None = None
    date: str | None = None
    run: Path | None = None

    @property
    def rasters(self) -> tuple[Path, Path | float | None, str | None]:
        """Orthophoto, DSM and vertical datum, as the reader takes them."""
        return self.ortho, self.dsm, self.vertical_datum

    def credited(self, rights: Mapping[str, str]) -> ReferenceFiles:
        """With what `RIGHTS` name."""
        return replace(self, licence=rights.get("licence"), credit=rights.get("credit"), date=rights.get("date"))


def earlier_run(folder: Path) -> ReferenceFiles:
    """The orthophoto and the DSM of a finished run as a reference, with their accuracy as that run predicted it.

    It is the sum of the error of that run's own reference and of its registration, where several components are
    registered that of the least accurate one. Heights that were not confirmed are left out. Raises `InputError` where
    the run is not there, has nothing registered from above, or is of a version that did not tell this accuracy.
    """
    path = folder / "summary.json"
    try:
        summary = json.loads(regular(path).read_text(encoding="utf-8"))
        parts = [part for one in summary["sets"] for part in one["components"] if part["status"] == "REGISTERED"]
        rights = {key: summary["reference"][key] for key in RIGHTS if summary["reference"].get(key)}
        known = summary["reference"]["covariance_m2"] is not None
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: no summary of a finished run ({error}); name the folder of a run") from error
    ortho, dsm = folder / "ortho.tif", folder / "dsm.tif"
    missing = next((one for one in (ortho, dsm) if not one.is_file()), None)
    if missing is not None:
        raise InputError(f"{missing}: the run has no such product, so it cannot be a reference; name another run")
    surfaces = [part["surface_accuracy"] for part in parts if part.get("surface_accuracy")]
    if not surfaces:
        raise InputError(f"{path}: does not say how accurate its surface is; give the command of that run again")
    with_heights = all(part.get("heights") != "NOT_CONFIRMED" for part in parts)
    covariance = _covariance(surfaces, path) if known else UNKNOWN_ACCURACY
    files = ReferenceFiles(ortho, dsm if with_heights else None, "ellipsoid", covariance, run=folder)
    return files.credited(rights)


def _covariance(surfaces: list[dict[str, Any]], path: Path) -> Array:
    """Of the least accurate surface, m^2."""
    worst = max(surfaces, key=lambda one: float(np.trace(np.array(one["covariance_m2"]))))
    return checked_covariance(worst["covariance_m2"], name=f"{path}: surface_accuracy.covariance_m2")
