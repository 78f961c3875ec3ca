# SPDX-License-Identifier: Apache-2.0
"""Wrong usage in one line: which option or value, and the nearest one that there is."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from typing import Any

from skymoor.errors import InputError
from skymoor.pipeline.option_parser import close_to

FLAG = re.compile(r"(?<![\w-])--[a-z0-9][a-z0-9-]*")
RUN_TOGETHER = re.compile(r"-[a-z][a-z-]+")  # a long option after one dash, or short ones without a space
SIDES, RULES = " ╭╮╰╯│+|", "─-"  # of the box, which is of ASCII where the terminal is
ENDS = ("Argument helptext", "For full helptext", "Perhaps you meant")
KINDS = {"INT": "a whole number", "FLOAT": "a number", "PATH": "a path"}


def parsed(parse: Callable[[list[str]], Any], arguments: Sequence[str]) -> Any:
    """What `parse` makes of the arguments; it prints and exits where they are wrong, as argparse does.

    Raises `InputError`, one line, in place of what it would print about them.
    """
    printed = io.StringIO()
    try:
        if not any(map(RUN_TOGETHER.fullmatch, arguments)):  # it would be taken for -o and its value
            with redirect_stderr(printed):
                return parse(list(arguments))
    except SystemExit as ended:
        if not ended.code:  # help, and completions
            raise
    raise InputError(_line(parse, arguments, printed.getvalue()))


def _line(parse: Callable[[list[str]], Any], arguments: Sequence[str], box: str) -> str:
    """What is wrong, of the arguments and of the box of lines that the parser printed."""
    command, help_text = _command(parse, arguments)
    begin, ask = (f"{command}: ", f"skymoor {command} --help") if command else ("", "skymoor --help")
    known = dict.fromkeys(FLAG.findall(help_text))
    for word in arguments:
        flag = word.partition("=")[0].replace("_", "-")
        short = RUN_TOGETHER.fullmatch(flag) is not None
        flag = f"-{flag}" if short else flag
        if FLAG.fullmatch(flag) and (short or flag not in known):
            meant = close_to(flag, [one for one in known if one.startswith("--no-") == flag.startswith("--no-")])
            remedy = f"did you mean {meant[0]}?" if meant else f"{ask} lists all"
            return f"{begin}there is no option {word.partition('=')[0]}; {remedy}"
    return f"{begin}{_told(box)}; {ask} explains it"


def _told(box: str) -> str:
    """What a box of lines says, in one."""
    lines = [line.strip(SIDES) for line in box.splitlines()]
    title, *texts = [line for line in lines if line.strip(RULES)] or ["wrong usage"]
    title = title.strip(f"{RULES} ")
    if "Required" in title:
        texts = [re.sub(r"^-\w \S+, (?=--)", "", line) for line in texts]  # the short form of an option
        missing = [line.removesuffix(" (required)") for line in texts if re.match(r"--|[A-Z]+\b(?! *[a-z])", line)]
        missing = [line.replace("STR", "a name") for line in missing] or ["an argument"]
        return f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
    ends = [k for k, line in enumerate(texts) if line.startswith(ENDS)]
    text = " ".join(texts[: min(ends, default=len(texts))]).rstrip(".") or title
    choice = re.match(r"invalid choice ('.*') for argument '(\S+)'. Expected one of \((.*)\)$", text)
    if choice is not None:
        *names, last = sorted(set(re.findall(r"'([^']*)'", choice[3])) - {"None"})
        return f"{choice[2]} {choice[1]} must be {', '.join(names)}{' or ' if names else ''}{last}"
    wrong = re.match(r"Error parsing (\S+):.*?('[^']*')?$", text)
    if wrong is not None:
        kind = next((line for line in texts if line.startswith(f"{wrong[1]} ")), "").partition(" ")[2]
        kind = kind.replace("{None}|", "").strip("{}")
        return f"{wrong[1]} {wrong[2] or ''} must be {KINDS.get(kind, kind)}".replace("  ", " ")
    return text.replace("Unrecognized options: ", "not understood: ").replace(" Available", "; available")


def _command(parse: Callable[[list[str]], Any], arguments: Sequence[str]) -> tuple[str, str]:
    """The command that is meant, such as "weights fetch", and its help."""
    name = arguments[0] if arguments and not arguments[0].startswith("-") else ""
    help_text = _help(parse, [name] if name else [])
    inner = re.search(r"\{([a-z,]+)\}", help_text.partition("\n\n")[0])
    if name and inner and len(arguments) > 1 and arguments[1] in inner[1].split(","):
        return f"{name} {arguments[1]}", _help(parse, [name, arguments[1]])
    return name, help_text


def _help(parse: Callable[[list[str]], Any], names: Sequence[str]) -> str:
    """The help of a command; empty where there is no such command."""
    shown = io.StringIO()
    with redirect_stdout(shown), redirect_stderr(io.StringIO()), suppress(SystemExit):
        parse([*names, "--help"])
    return shown.getvalue()
