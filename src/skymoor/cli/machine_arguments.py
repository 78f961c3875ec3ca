# SPDX-License-Identifier: Apache-2.0
"""Arguments of the commands about the machine and the program itself; the texts under the fields are their help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from skymoor.cli.short import Out, Quiet, Verbose, helpful


@dataclass(frozen=True)
class Schema:
    """Print the JSON schema of site.toml, for editors that complete and check it.

    For example: skymoor schema > site.schema.json
    """


@dataclass(frozen=True)
class Doctor:
    """Check whether this machine has what runs need: versions, GPU, memory, disk, weights."""

    out: Out = Path()
    """Folder where results will be written."""
    json: bool = False
    """For scripts: as JSON on stdout."""


@dataclass(frozen=True)
class Completion:
    """Print a shell script that completes commands and options.

    For example: skymoor completion bash > ~/.local/share/bash-completion/completions/skymoor
    """

    shell: Annotated[Literal["bash", "zsh", "tcsh"], tyro.conf.Positional]


@helpful
@dataclass(frozen=True)
class GridsList:
    """List the grids of common datums, and which are installed; downloads nothing."""

    json: bool = False
    """For scripts: as JSON on stdout."""


@helpful
@dataclass(frozen=True)
class GridsFetch:
    """Download a grid from PROJ's server and check it.

    For example: skymoor grids fetch us_nga_egm08_25.tif, or skymoor grids fetch EPSG:3855
    """

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """File of the grid, or EPSG code of a datum that has one grid."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""


@dataclass(frozen=True)
class Grids:
    """Grids of geoids and datum shifts, which PROJ needs for some references; runs download nothing."""

    action: (
        Annotated[GridsList, tyro.conf.subcommand("list", prefix_name=False)]
        | Annotated[GridsFetch, tyro.conf.subcommand("fetch", prefix_name=False)]
    )


@helpful
@dataclass(frozen=True)
class WeightsList:
    """List pretrained weights, their licences, and which are installed."""

    json: bool = False
    """For scripts: as JSON on stdout."""


@helpful
@dataclass(frozen=True)
class WeightsFetch:
    """Download pretrained weights and check them.

    For example: skymoor weights fetch aliked
    """

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """As in the list."""
    to: Path | None = None
    """Folder of all weights; $SKYMOOR_WEIGHTS or the user's data folder by default."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""


@dataclass(frozen=True)
class Weights:
    """Pretrained weights of optional engines; runs download nothing."""

    action: (
        Annotated[WeightsList, tyro.conf.subcommand("list", prefix_name=False)]
        | Annotated[WeightsFetch, tyro.conf.subcommand("fetch", prefix_name=False)]
    )


@dataclass(frozen=True)
class Help:
    """Explain the commands, or one of them, as --help does.

    For example: skymoor help run
    """

    command: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="COMMAND")] = None
    """One of the commands; all without it."""


@dataclass(frozen=True)
class Version:
    """Print the version, as --version does."""
