# SPDX-License-Identifier: Apache-2.0
"""The command line: parses and prints, nothing else."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence
from functools import reduce
from operator import or_
from typing import Annotated, Any

import tyro

from skymoor import __version__
from skymoor.cli.arguments import (
    Batch,
    Clean,
    Completion,
    Demo,
    Doctor,
    Evaluate,
    Export,
    Grids,
    Index,
    Reference,
    Report,
    Run,
    Schema,
    Simulate,
    View,
    Weights,
)
from skymoor.errors import BackendUnavailable, InputError, SkymoorError
from skymoor.pipeline.option_parser import nearest

# Errors of disks and paths, which the user can fix; all others are errors of this program.
OF_THE_DISK = (
    *(errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO),
    *(errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.ELOOP),
)
COMMANDS = {
    "run": Run,
    "batch": Batch,
    "evaluate": Evaluate,
    "export": Export,
    "report": Report,
    "view": View,
    "clean": Clean,
    "simulate": Simulate,
    "demo": Demo,
    "weights": Weights,
    "grids": Grids,
    "reference": Reference,
    "index": Index,
    "doctor": Doctor,
    "schema": Schema,
    "completion": Completion,
}
_Command: Any = tyro.conf.OmitArgPrefixes[  # type: ignore[misc]
    reduce(or_, (Annotated[kind, tyro.conf.subcommand(name)] for name, kind in COMMANDS.items()))
]
DESCRIPTION = """skymoor georegisters 3D models: photos without metadata, an orthophoto and its DSM go
in, and every camera and model gets a position on Earth with its accuracy, or the reason why it has none.

Begin with: skymoor doctor, then skymoor demo, then skymoor run site.toml --out result. Each command explains itself:
skymoor run --help."""
EXIT_REGISTERED, EXIT_ERROR, EXIT_USAGE, EXIT_NOT_REGISTERED = 0, 1, 2, 3
EXIT_BROKEN_PIPE, EXIT_INTERRUPTED = 141, 130  # as a shell reports the signals


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        print(__version__)
        return 0
    try:
        if arguments and not arguments[0].startswith("-") and arguments[0] not in COMMANDS:
            raise InputError(f"there is no command {arguments[0]}; {nearest(arguments[0], list(COMMANDS))}")
        chosen = tyro.cli(_Command, args=arguments, prog="skymoor", description=DESCRIPTION)
        status = _done(chosen)
        sys.stdout.flush()
        return status
    except (InputError, BackendUnavailable) as error:  # such as a chosen engine that is not installed
        _tell(error)
        for line in getattr(error, "details", ()):
            print(line, file=sys.stderr)
        return EXIT_USAGE
    except SkymoorError as error:
        _tell(error)
        return EXIT_ERROR
    except BrokenPipeError:  # whoever read the output, such as head, has enough
        sys.stdout = open(os.devnull, "w")  # noqa: PTH123, SIM115 - or the interpreter complains when it ends
        return EXIT_BROKEN_PIPE
    except OSError as error:
        if error.errno not in OF_THE_DISK:
            raise
        _tell(
            f"{error.filename or 'a file'}: {error.strerror}; once that is fixed, the same command continues from here"
        )
        return EXIT_USAGE
    except KeyboardInterrupt:
        print("skymoor: stopped; the same command continues from here", file=sys.stderr)
        return EXIT_INTERRUPTED


def _done(chosen: Any) -> int:
    """The exit status of a command that raised nothing."""
    if isinstance(chosen, Completion):
        return main(["--tyro-print-completion", chosen.shell])
    from skymoor.cli import commands

    if isinstance(chosen, Evaluate):
        commands.evaluate(chosen)
    elif isinstance(chosen, Export):
        commands.export(chosen)
    elif isinstance(chosen, Report):
        commands.report(chosen)
    elif isinstance(chosen, View):
        commands.view(chosen)
    elif isinstance(chosen, Clean):
        commands.clean(chosen)
    elif isinstance(chosen, Schema):
        commands.schema()
    elif isinstance(chosen, Simulate):
        commands.simulate(chosen)
    elif isinstance(chosen, Weights):
        commands.weights(chosen)
    elif isinstance(chosen, Grids):
        commands.grids(chosen)
    elif isinstance(chosen, Reference):
        commands.reference(chosen)
    elif isinstance(chosen, Batch):
        return commands.batch(chosen)
    elif isinstance(chosen, Index):
        commands.index(chosen)
    elif isinstance(chosen, Doctor):
        return EXIT_REGISTERED if commands.doctor(chosen) else EXIT_ERROR
    else:
        done = commands.run(chosen) if isinstance(chosen, Run) else commands.demo(chosen)
        return EXIT_REGISTERED if done else EXIT_NOT_REGISTERED
    return EXIT_REGISTERED


def _tell(error: SkymoorError | str) -> None:
    """One line that a terminal can show, also where a file's name or a library's message has other characters."""
    line = "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in str(error)
    )
    print(f"skymoor: {line}", file=sys.stderr)
