# SPDX-License-Identifier: Apache-2.0
"""The command line: parses and prints, nothing else."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import reduce
from operator import or_
from typing import Annotated, Any

import tyro

from skymoor import __version__
from skymoor.cli.arguments import (
    Bench,
    Clean,
    Demo,
    Evaluate,
    Export,
    Index,
    Reference,
    Report,
    Run,
    Simulate,
    View,
)
from skymoor.cli.batch_arguments import Batch
from skymoor.cli.guide_arguments import Ask, Init
from skymoor.cli.interrupt import GRACE_S, STOPPED, STOPPING, Stopped, cpu_limit_told, interruptible
from skymoor.cli.limits import no_memory, require_address_space
from skymoor.cli.machine_arguments import Completion, Doctor, Grids, Help, Schema, Version, Weights
from skymoor.cli.overview import overview
from skymoor.cli.register_arguments import Register
from skymoor.cli.short import helpful
from skymoor.cli.usage import parsed
from skymoor.errors import BackendUnavailable, InputError, SkymoorError
from skymoor.pipeline.log import quiet_libraries
from skymoor.pipeline.option_parser import close_to

# Errors of disks and paths, which the user can fix; all others are errors of this program.
OF_THE_DISK = (
    *(errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO),
    *(errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.EFBIG, errno.EMFILE, errno.ENFILE),
)
COMMANDS = {
    "init": Init,
    "run": Run,
    "register": Register,
    "ask": Ask,
    "batch": Batch,
    "evaluate": Evaluate,
    "bench": Bench,
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
    "help": Help,
    "version": Version,
}
_Command: Any = Annotated[
    reduce(or_, (Annotated[helpful(kind), tyro.conf.subcommand(name)] for name, kind in COMMANDS.items())),
    tyro.conf.OmitArgPrefixes,
    tyro.conf.DisallowNone,  # or it would be offered as a value
    tyro.conf.FlagCreatePairsOff,  # --quiet needs no --no-quiet
]
EXIT_REGISTERED, EXIT_ERROR, EXIT_USAGE, EXIT_NOT_REGISTERED = 0, 1, 2, 3
EXIT_BROKEN_PIPE, EXIT_INTERRUPTED = 141, 130  # as a shell reports the signals
TOLD = {View: "", Ask: ""}  # those who wait for a person just end
WITH_COLMAP = (Ask, Demo, Export, Register, Report, Run, View)
PASSED_ON_S = 1.5  # more patience, with the processes that have to end before


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        print(__version__)
        return 0
    try:
        if arguments in ([], ["--help"], ["-h"], ["help"]):
            print(overview(COMMANDS), flush=True)
            return 0
        if arguments and not arguments[0].startswith("-"):
            _require_command(arguments[0])
        with cpu_limit_told():
            status = _done(parsed(_parse, arguments))
        sys.stdout.flush()
        return status
    except (InputError, BackendUnavailable) as error:  # such as a chosen engine that is not installed
        _tell((isinstance(error, BackendUnavailable) and no_memory(error)) or error)
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
    except (MemoryError, ImportError, RuntimeError) as error:
        line = no_memory(error)
        if not line:
            raise
        _tell(line)
        return EXIT_USAGE
    except KeyboardInterrupt as stop:
        with suppress(OSError):  # the terminal may be gone
            print(stop.line if isinstance(stop, Stopped) else STOPPED, file=sys.stderr)
        return stop.status if isinstance(stop, Stopped) else EXIT_INTERRUPTED


def _parse(arguments: list[str]) -> Any:
    return tyro.cli(_Command, args=arguments, prog="skymoor")


def _require_command(name: str) -> None:
    if name not in COMMANDS:
        close = close_to(name, list(COMMANDS))
        remedy = f"did you mean {' or '.join(close)}?" if close else "skymoor help lists all"
        raise InputError(f"there is no command {name}; {remedy}")


def _done(chosen: Any) -> int:
    """The exit status of a command that raised nothing."""
    if isinstance(chosen, Completion):
        return main(["--tyro-print-completion", chosen.shell])
    if isinstance(chosen, Version):
        return main(["--version"])
    if isinstance(chosen, Help):
        _require_command(chosen.command or "help")  # without one, main has answered
        return main([chosen.command or "help", "--help"])
    from skymoor.cli import batch, commands, guide, machine

    actions: dict[type, Callable[[Any], bool | int | None]] = {
        Ask: guide.ask,
        Batch: batch.batch,
        Bench: machine.bench,
        Clean: commands.clean,
        Demo: commands.demo,
        Doctor: machine.doctor,
        Evaluate: commands.evaluate,
        Export: commands.export,
        Grids: machine.grids,
        Index: commands.index,
        Init: guide.init,
        Reference: commands.reference,
        Register: commands.register,
        Report: commands.report,
        Run: commands.run,
        Schema: machine.schema,
        Simulate: commands.simulate,
        View: commands.view,
        Weights: machine.weights,
    }
    action = actions[type(chosen)]
    if isinstance(chosen, WITH_COLMAP):
        require_address_space()
        import pycolmap  # noqa: F401 - before signals are listened to, since it takes SIGTERM for itself
    told, grace_s = TOLD.get(type(chosen), STOPPING), GRACE_S + (PASSED_ON_S if isinstance(chosen, Batch) else 0.0)
    with quiet_libraries():
        done = interruptible(lambda: action(chosen), told=told, grace_s=grace_s)
    if done is False:
        return EXIT_ERROR if isinstance(chosen, Doctor) else EXIT_NOT_REGISTERED
    return EXIT_REGISTERED if done is None or done is True else done


def _tell(error: SkymoorError | str) -> None:
    """One line that a terminal can show, also where a file's name or a library's message has other characters."""
    line = "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in str(error)
    )
    print(f"skymoor: {line}", file=sys.stderr)
