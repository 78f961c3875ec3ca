# SPDX-License-Identifier: Apache-2.0
"""The source text that a stage's result depends on: its function's module and all that this module imports.

Imports are read from the source, also those inside functions, so that nothing is loaded to know them. A package that
only hands names on (`from skymoor.match import cyclic_matches`) is looked through to the module that defines the name:
a change in one matcher does not concern the stages that use another.
"""

from __future__ import annotations

import ast
import hashlib
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

import skymoor

ROOT = skymoor.__name__
FOLDER = Path(skymoor.__file__).parent
BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")  # of statements within a statement


def defining_modules(function: Callable[..., object], values: Iterable[object] = ()) -> frozenset[str]:
    """Names of the modules that define a function, or a callable object, and the types of `values`.

    Raises `ValueError` for a function without a name of its own, such as a lambda: what it captures is in no source.
    """
    if "<" in (name := name_of(function)):
        raise ValueError(f"{name}: a stage is a function of a module, or a callable object, not a local function")
    home = getattr(function, "__module__", None) or type(function).__module__
    return frozenset([home, *(type(value).__module__ for value in values)])


def name_of(function: Callable[..., object]) -> str:
    """Of a function, or of the class of a callable object."""
    return str(getattr(function, "__qualname__", getattr(function, "__name__", type(function).__qualname__)))


def fingerprint(modules: Iterable[str]) -> str:
    """SHA-256, in hexadecimal, of the source text of modules and of all modules of this package that they import."""
    total = hashlib.sha256()
    for name in sorted(import_closure(modules)):
        total.update(f"{name}:{_text_digest(_source(name))}\n".encode())
    return total.hexdigest()


def import_closure(modules: Iterable[str]) -> frozenset[str]:
    """The modules and all that they import, directly or not, of this package; others only where they are named."""
    found: set[str] = set()
    left = [name for name in modules if _source(name) is not None]
    while left:
        name = left.pop()
        if name not in found:
            found.add(name)
            left += _imports(name)
    return frozenset(found)


@cache
def _imports(name: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(_imported(name)))


def _imported(name: str) -> Iterator[str]:
    for node in _statements(_tree(name)):
        if isinstance(node, ast.ImportFrom) and node.module and _ours(node.module):
            for alias in node.names:
                yield from _home(node.module, alias.name)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if _ours(alias.name) and alias.name != ROOT)


def _home(module: str, name: str) -> Iterator[str]:
    """The module that `from module import name` refers to; none for names of the package itself, as its version."""
    if _source(f"{module}.{name}") is not None:
        yield f"{module}.{name}"
    elif name in (handed := _handed_on(module)):
        yield from _home(*handed[name])
    elif module != ROOT and _source(module) is not None:
        yield module


@cache
def _handed_on(module: str) -> dict[str, tuple[str, str]]:
    """What a package imports for others, by name: module and name there. Empty for modules."""
    source = _source(module)
    if source is None or source.name != "__init__.py" or module == ROOT:
        return {}
    return {
        alias.asname or alias.name: (node.module, alias.name)
        for node in _tree(module).body
        if isinstance(node, ast.ImportFrom) and node.module and _ours(node.module)
        for alias in node.names
    }


def _statements(tree: ast.Module) -> Iterator[ast.AST]:
    """All statements but those for the type checker alone; no expression can hold an import."""
    left: list[ast.AST] = [tree]
    while left:
        node = left.pop()
        yield node
        blocks = BLOCKS[1:] if isinstance(node, ast.If) and _is_typing_only(node.test) else BLOCKS
        left += [child for block in blocks for child in getattr(node, block, ())]


def _is_typing_only(test: ast.expr) -> bool:
    return "TYPE_CHECKING" in (getattr(test, "id", ""), getattr(test, "attr", ""))


def _ours(name: str) -> bool:
    return name == ROOT or name.startswith(f"{ROOT}.")


@cache
def _source(name: str) -> Path | None:
    """The file of a module; None for what has none, as modules in C and names that are no module."""
    if _ours(name):
        base = FOLDER.joinpath(*name.split(".")[1:])
        return next((file for file in (base.with_suffix(".py"), base / "__init__.py") if file.is_file()), None)
    file = getattr(sys.modules.get(name), "__file__", None)
    return Path(file) if file and file.endswith(".py") and not _installed(Path(file)) else None


def _installed(file: Path) -> bool:
    """Libraries are known by their versions, not by their text."""
    return any(part in ("site-packages", "dist-packages") for part in file.parts) or file.is_relative_to(
        sys.base_prefix
    )


@cache
def _tree(name: str) -> ast.Module:
    source = _source(name)
    assert source is not None
    return ast.parse(source.read_text(encoding="utf-8"))


@cache
def _text_digest(source: Path | None) -> str:
    return "" if source is None else hashlib.sha256(source.read_bytes()).hexdigest()


def forget() -> None:
    """Read all sources again: for tests that change them."""
    for cached in (_imports, _handed_on, _source, _tree, _text_digest):
        cached.cache_clear()
