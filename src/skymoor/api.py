# SPDX-License-Identifier: Apache-2.0
"""skymoor for notebooks and scripts: what `skymoor run` does, as a function that returns what came of it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from numbers import Integral, Real
from os import PathLike
from pathlib import Path

from skymoor.cli import commands
from skymoor.cli.arguments import Run
from skymoor.errors import InputError
from skymoor.results.read import Result

Where = str | PathLike[str]


def register(
    site: Where | None = None,
    *,
    out: Where,
    airborne: Where | None = None,
    ground: Where | Sequence[Where] = (),
    ortho: Where | None = None,
    dsm: Where | None = None,
    vertical_datum: str | None = None,
    ce90: float | None = None,
    le90: float | None = None,
    options: Mapping[str, object] | None = None,
    seed: int = 0,
) -> Result:
    """Place a site's photos on the Earth, and read back what came of it.

    Call it again with the same `out` to go on where it stopped. It prints one line for each finished stage, as
    `skymoor run --quiet` does.

    Args:
        site: site.toml; or name the data by `airborne`, `ortho` and `dsm`.
        out: folder for the results.
        airborne: folder of airborne photos.
        ground: a folder of ground photos, or several.
        ortho: orthophoto, any CRS that GDAL reads.
        dsm: its surface model, heights in metres.
        vertical_datum: what the DSM's heights refer to: "ellipsoid", or an EPSG code such as "EPSG:3855".
        ce90: circular error of the reference, 90 percent, metres.
        le90: linear (vertical) error of the reference, 90 percent, metres.
        options: by dotted names or nested, such as {"match.max_height_m": 150}; they overrule those of the site.
        seed: makes a run repeatable.

    Returns:
        The result, also where skymoor does not believe a place: `Result.registered` and the reasons of its
        components say so.

    Raises:
        InputError: data or options are wrong; one line names the file and the mend.
        BackendUnavailable: an optional engine was asked for that is not installed, or whose weights are not here.
    """
    folders = [ground] if isinstance(ground, str | PathLike) else ground
    command = Run(
        site=_path(site),
        out=Path(out),
        airborne=_path(airborne),
        ground=tuple(Path(folder) for folder in folders),
        ortho=_path(ortho),
        dsm=_path(dsm),
        vertical_datum=vertical_datum,
        ce90=ce90,
        le90=le90,
        set=tuple(_settings(options or {})),
        seed=seed,
        quiet=True,
    )
    commands.run(command)
    return Result.read(command.out)


def read(folder: Where) -> Result:
    """Read the folder of a finished run.

    Raises:
        InputError: there is none, or it is damaged.
    """
    return Result.read(Path(folder))


def _path(where: Where | None) -> Path | None:
    return None if where is None else Path(where)


def _settings(options: Mapping[str, object], prefix: str = "") -> Iterator[str]:
    """As the command line has them: NAME=VALUE."""
    for name, value in options.items():
        if isinstance(value, Mapping):
            yield from _settings(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}={_spelt(value, prefix + name)}"


def _spelt(value: object, name: str) -> str:
    """A value in TOML, or "none"."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Integral):  # also numpy's
        return str(int(value))
    if isinstance(value, Real):
        return repr(float(value))
    if isinstance(value, str | PathLike):
        return json.dumps(str(value), ensure_ascii=False)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_spelt(item, name) for item in value)}]"
    raise InputError(f"options: {name} = {value!r} is no number, text, truth value or list of them; write it as one")
