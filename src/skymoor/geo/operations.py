# SPDX-License-Identifier: Apache-2.0
"""Coordinate operations of PROJ: how accurate the one is that was used, and which grid would make it better."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.datadir import get_data_dir, get_user_data_dir  # type: ignore[attr-defined]
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup

GRIDS = ("*.tif", "*.gtx", "*.gsb")
# A gain of less than this does not make a grid worth fetching.
LEAST_GAIN_M = 0.1
# A null transformation leaves the coordinates as they are, and its stated accuracy bounds how far apart two systems
# have drifted, such as ETRS89 and WGS 84 (IOGP 373-7-5): it is read as the 95 percent of a circle, or of a height.
NULL_SIGMAS = {"horizontal": float(np.sqrt(-2.0 * np.log(0.05))), "vertical": 1.959963984540054}
# WGS 84 and its realisations are one reference system to a few centimetres, whatever the looseness of the ensemble.
_REALISATION = re.compile(r"(inverse of )?WGS 84 to WGS 84 \(\w+\)", re.IGNORECASE)


@dataclass(frozen=True)
class Operation:
    """The operation that takes a raster's coordinates, or its heights, to WGS 84.

    Attributes:
        name: of its steps that have an accuracy, as EPSG calls them.
        stated_m: accuracy that PROJ states, metres; 0 for an exact one, NaN where it states none.
        sigma_m: standard deviation of each horizontal axis, or of the height, that follows; 0 where none is stated.
        better_m, missing: the accuracy of a better operation, and the grid files that it lacks here; empty without one.
    """

    name: str = ""
    stated_m: float = 0.0
    sigma_m: float = 0.0
    better_m: float = 0.0
    missing: tuple[str, ...] = ()


EXACT = Operation()


def horizontal_operation(crs: CRS, lon: float, lat: float) -> Operation:
    """What PROJ uses from WGS 84 to a two-dimensional CRS at a position in degrees, and what would be better."""
    used = Transformer.from_crs("EPSG:4326", crs, always_xy=True, allow_ballpark=False)
    used.transform(lon, lat)
    try:
        chosen = used.get_last_used_operation()
    except ProjError:  # there is only one
        chosen = used
    area = AreaOfInterest(lon, lat, lon, lat)
    return operation_of(chosen, operations_between("EPSG:4326", crs, area).unavailable_operations, "horizontal")


def operations_between(source: Any, target: Any, area: AreaOfInterest | None) -> TransformerGroup:
    """All operations of PROJ for an area, of which those are unavailable that need a missing grid; no ballpark ones.

    Ballpark operations leave out the shift of the datum, or pass heights through where no geoid grid is installed.
    """
    with warnings.catch_warnings():
        # pyproj warns that a better grid exists somewhere; which ones are missing is reported by name.
        warnings.simplefilter("ignore")
        return TransformerGroup(
            source,
            target,
            always_xy=True,
            area_of_interest=area,  # type: ignore[arg-type]
            allow_ballpark=False,
        )


def operation_of(used: Transformer, unavailable: Iterable[Any], kind: str) -> Operation:
    """The facts of a transformer with one operation; `kind` is "horizontal" or "vertical".

    EPSG's accuracies have no common level of confidence (guidance note 373-7-1): some are the residuals of a fit, some
    its precision, some a bound. They are taken for one standard deviation of each axis, which errs on the safe side.
    """
    steps = [step for step in used.operations or () if not _REALISATION.fullmatch(step.name)]
    known = [step for step in steps if step.accuracy > 0]
    if used.accuracy < 0:
        return Operation(used.description, float("nan"))
    variance = sum((step.accuracy / (NULL_SIGMAS[kind] if _is_null(step) else 1.0)) ** 2 for step in known)
    stated = float(sum(step.accuracy for step in known))
    better_m, missing = _better(stated, unavailable)
    return Operation(
        " + ".join(_plain_name(step) for step in known), stated, float(np.sqrt(variance)), better_m, missing
    )


def missing_grids(group: TransformerGroup) -> list[str]:
    """Files that unavailable operations of a group lack, the best first.

    Operations that need one file come first, of those the ones that PROJ offers for download, else in PROJ's order.
    """
    missing = [lacking(operation) for operation in group.unavailable_operations]
    missing.sort(key=lambda grids: (len(grids) > 1, not all(grid.url for grid in grids)))
    return list(dict.fromkeys(grids[0].short_name for grids in missing if grids))


def needed_grid(group: TransformerGroup) -> str:
    """The grid that a group without an installed operation needs, and how to get it; empty where no grid would help."""
    files = missing_grids(group)
    if not files:
        return ""
    others = f" (or one of {', '.join(files[1:5])})" if len(files) > 1 else ""
    remedy = f"run `skymoor grids fetch {files[0]}`, or put the file into {get_user_data_dir()}"
    return f"{files[0]}{others}, which is not installed: {remedy}"


def lacking(operation: Any) -> list[Any]:
    """The grids of an operation that are not installed."""
    return [grid for grid in operation.grids if not grid.available]


def installed_grids() -> list[str]:
    """Names of the grid files that PROJ finds on this machine; which operation it chooses depends on them."""
    return sorted({file.name for folder in _folders() for pattern in GRIDS for file in folder.glob(pattern)})


def grid_file(name: str) -> Path | None:
    """Where PROJ finds a grid file; None if it is not installed."""
    return next((folder / name for folder in _folders() if (folder / name).is_file()), None)


def _folders() -> list[Path]:
    return [Path(folder) for folder in (get_user_data_dir(), *get_data_dir().split(os.pathsep))]


def accuracy_note(operation: Operation, what: str) -> str:
    """One sentence about what the operation adds to the accuracy of `what`, such as "ortho.tif"; "" for nothing."""
    name = operation.name
    if np.isnan(operation.stated_m):
        return (
            f"{what}: PROJ states no accuracy for the transformation to WGS 84 ({name}); none is added to the reference"
        )
    if operation.sigma_m < LEAST_GAIN_M:
        return ""
    text = (
        f"{what}: the transformation to WGS 84 ({name}) is accurate to {operation.stated_m:g} m as PROJ states, "
        f"which is added to the accuracy of the reference (standard deviation {operation.sigma_m:.2g} m)"
    )
    if operation.missing:
        grids = " and ".join(f"`skymoor grids fetch {grid}`" for grid in operation.missing)
        text += f"; {operation.better_m:g} m with a grid that is not installed: {grids}"
    return text


def _better(stated_m: float, unavailable: Iterable[Any]) -> tuple[float, tuple[str, ...]]:
    """Accuracy of the best operation that is better, and the files that it lacks; only such as can be fetched."""
    candidates = []
    for operation in unavailable:
        grids = lacking(operation)
        gain = stated_m - operation.accuracy
        if operation.accuracy > 0 and gain >= LEAST_GAIN_M and grids and all(grid.url for grid in grids):
            candidates.append((operation.accuracy, tuple(grid.short_name for grid in grids)))
    return min(candidates, key=lambda one: (one[0], len(one[1])), default=(0.0, ()))


def _plain_name(step: Any) -> str:
    return str(step.name).removeprefix("Inverse of ")


def _is_null(step: Any) -> bool:
    """Whether all parameters of the step are zero, so that coordinates pass unchanged."""
    values = [parameter.value for parameter in step.params]
    return bool(values) and all(isinstance(value, int | float) and value == 0 for value in values)
