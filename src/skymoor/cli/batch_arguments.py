# SPDX-License-Identifier: Apache-2.0
"""Arguments of `skymoor batch`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from skymoor.cli.short import Quiet, Verbose
from skymoor.pipeline.stopping import StopAfter


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Run many sites, each in a process of its own, on this machine or on a Dask cluster.

    For example:

    skymoor batch sites/* --out results --workers 4 --memory 8

    skymoor batch sites/* --out /shared/results --scheduler tcp://10.0.0.1:8786

    skymoor batch sites/* --out s3://bucket/results --stop-after depth

    The same command again continues where it stopped. Exit status: 0 all sites are registered (or stopped as asked), 3
    some are not, 2 some have wrong input, 1 some failed.
    """

    sites: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """site.toml files, folders that have one, or folders of such folders."""
    out: Annotated[str, tyro.conf.arg(aliases=["-o"], metavar="PATH|ADDRESS")]
    """Folder for the results: a folder for each site, batch.json and batch.html. Or its address in an object store, as
    s3://bucket/results: this needs skymoor[dask] and the store's package, such as s3fs."""
    workers: int = 1
    """Sites at a time on this machine."""
    memory: float | None = None
    """Most memory of one site, in gigabytes; one that needs more fails, and only it."""
    scheduler: str | None = None
    """Address of a Dask scheduler whose workers see the sites and --out under the same paths or addresses; needs
    skymoor[dask]."""
    only: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A site by the name of its folder; may be repeated."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """An option of all sites by its dotted name; may be repeated."""
    seed: int = 0
    """Makes runs repeatable."""
    stop_after: StopAfter | None = None
    """The last step of every site, as of skymoor run; the same command without it goes on from there."""
    quiet: Quiet = False
    """Plain lines in place of progress bars."""
    verbose: Verbose = False
    """Also show what goes to the log."""
    json: bool = False
    """For scripts: the outcomes as JSON on stdout, all else on stderr."""
