# SPDX-License-Identifier: Apache-2.0
"""Options by their dotted names: set in nested frozen dataclasses, with every type and name checked."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import Field, fields, is_dataclass, replace
from difflib import get_close_matches
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from skymoor.engines.options import is_fixed
from skymoor.errors import InputError

T = TypeVar("T")

MOST_NAMES = 20  # in a message


def with_options(config: T, options: Mapping[str, object], source: str = "options") -> T:
    """The dataclass tree `config` with some of its fields replaced.

    A key is the name of a field, or a dotted path such as "match.cycle_px"; a mapping as value goes one level down,
    so that nested and dotted spellings mean the same. `source` says in messages where the options came from.
    Raises `InputError` for a name that does not exist (with the nearest that do), for a value of the wrong type and
    for one that the dataclass itself refuses.
    """
    known = tuple(option_names(config))
    # A dict: of two spellings of one option the later wins, so that the command line can overrule a file.
    return _applied(config, "", dict(_flat(options)), known, source)


def option_names(config: object, prefix: str = "") -> Iterator[str]:
    """Dotted names of all options of a dataclass tree, in the order of their definition."""
    for item in option_fields(config):
        value = getattr(config, item.name)
        if is_dataclass(value):
            yield from option_names(value, f"{prefix}{item.name}.")
        else:
            yield f"{prefix}{item.name}"


def option_fields(config: object) -> list[Field[Any]]:
    """The fields of a dataclass, or of its type, that users may set."""
    return [item for item in fields(config) if not is_fixed(item)]  # type: ignore[arg-type]


def option_values(config: object) -> dict[str, object]:
    """All options with their values, nested as they are named."""
    values = {item.name: getattr(config, item.name) for item in option_fields(config)}
    return {name: option_values(value) if is_dataclass(value) else value for name, value in values.items()}


def parse_option(text: str) -> tuple[str, object]:
    """Name and value of "match.cycle_px=3": numbers, booleans, lists and quoted text as in TOML, else plain text.

    Raises `InputError` when there is no "=" or no name.
    """
    name, equals, raw = text.partition("=")
    name, raw = name.strip(), raw.strip()
    if not equals or not name:
        raise InputError(f"--set {text}: write it as NAME=VALUE, for example --set match.cycle_px=3")
    try:
        table = tomllib.loads(f"value = {raw}")
    except (ValueError, RecursionError):
        return name, raw
    value = table["value"]
    # Dates and inline tables are TOML as well, but no option wants them: the text is meant.
    usable = len(table) == 1 and isinstance(value, (bool, int, float, str, list))
    return name, value if usable else raw


def close_to(name: str, known: Sequence[str]) -> list[str]:
    """The known names that are spelt nearly like this one, the nearest first."""
    return get_close_matches(name, known, n=3, cutoff=0.5)


def nearest(name: str, known: Sequence[str]) -> str:
    """The end of a message about an unknown name: what is close to it, or what there is, if that is not too much."""
    close = close_to(name, known)
    if not close:  # the right name in the wrong group
        close = [other for other in known if other.rpartition(".")[2] == name.rpartition(".")[2]]
    if close:
        return "did you mean " + " or ".join(close) + "?"
    group = name.rpartition(".")[0]
    inside = [other for other in known if group and other.startswith(f"{group}.")]
    there = inside if 0 < len(inside) <= MOST_NAMES else list(known)
    if len(there) > MOST_NAMES:
        there = [f"{group}.*" for group in dict.fromkeys(other.partition(".")[0] for other in there)]
    return "known: " + ", ".join(there)


def _flat(options: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    for key, value in options.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _applied(config: T, prefix: str, values: Mapping[str, object], known: Sequence[str], source: str) -> T:
    """`config` with all `values` at once, since some only make sense together."""
    groups: dict[str, dict[str, object]] = {}
    for name, value in values.items():
        head, _, rest = name.partition(".")
        groups.setdefault(head, {})[rest] = value
    hints = get_type_hints(type(config))
    changes: dict[str, object] = {}
    for head, group in groups.items():
        name = prefix + head
        if head not in {item.name for item in option_fields(config)}:
            unknown = ".".join(filter(None, (name, next(iter(group)))))
            raise InputError(f"{source}: there is no option {unknown}; {nearest(unknown, known)}")
        child = getattr(config, head)
        if not is_dataclass(child):
            deeper = next(filter(None, group), None)
            if deeper is not None:
                raise InputError(f"{source}: there is no option {name}.{deeper}; did you mean {name}?")
            changes[head] = _checked(group[""], hints[head], f"{source}: option {name} = {group['']!r}")
        elif "" in group:
            inside = [other for other in known if other.startswith(f"{name}.")]
            raise InputError(f"{source}: {name} is a group of options, set one of {', '.join(inside[:MOST_NAMES])}")
        else:
            changes[head] = _applied(child, f"{name}.", group, known, source)
    try:
        return replace(config, **changes)  # type: ignore[type-var]
    except ValueError as error:
        raise InputError(f"{source}: {prefix.rstrip('.') or 'options'} {changes} are refused: {error}") from error


def _checked(value: object, annotation: Any, where: str) -> object:
    """`value` as the annotated type, or `InputError`."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, PathLike) and annotation is str:
        value = str(value)
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (Union, UnionType):
        return _checked_union(value, arguments, where)
    if origin is Literal:
        value = "none" if value is None else value
        if value not in arguments or isinstance(value, bool) != any(value is choice for choice in (True, False)):
            raise InputError(f"{where} must be one of {', '.join(map(repr, arguments))}")
        return value
    if annotation is tuple or origin is tuple:
        return _checked_tuple(value, arguments, where)
    if annotation is float and type(value) in (int, float):
        with suppress(OverflowError):  # a whole number with hundreds of digits
            number = float(value)  # type: ignore[arg-type]
            if not math.isnan(number):
                return number
    if annotation is Path and isinstance(value, (str, Path)):
        return Path(value)
    # type() and not isinstance(): True is an int for Python, but not for a person who counts.
    if annotation in (int, bool, str) and type(value) is annotation:
        return value
    raise InputError(f"{where} must be {_spelt(annotation)}")


def _checked_union(value: object, choices: tuple[Any, ...], where: str) -> object:
    if NoneType in choices and (value is None or (value == "none" and str not in choices)):
        return None
    for choice in choices:
        if choice is not NoneType:
            try:
                return _checked(value, choice, where)
            except InputError:
                continue
    raise InputError(f"{where} must be {' or '.join(_spelt(choice) for choice in choices)}")


def _checked_tuple(value: object, types: tuple[Any, ...], where: str) -> tuple[object, ...]:
    if not isinstance(value, (list, tuple)):
        raise InputError(f"{where} must be a list, for example [1, 2]")
    if not types or (len(types) == 2 and types[1] is Ellipsis):
        return tuple(_checked(item, types[0], where) for item in value) if types else tuple(value)
    if len(value) != len(types):
        raise InputError(f"{where} must have {len(types)} values")
    return tuple(_checked(item, kind, where) for item, kind in zip(value, types, strict=True))


def _spelt(annotation: Any) -> str:
    words = {float: "a number", int: "a whole number", bool: "true or false", str: "text", Path: "a path"}
    return words.get(annotation, '"none"' if annotation is NoneType else str(annotation))
