# SPDX-License-Identifier: Apache-2.0
"""No call in the sources can run code that stands in a file of weights or in the cache of a run."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import skymoor

SOURCES = Path(skymoor.__file__).parent


def calls(text: str) -> Iterator[tuple[str, dict[str, object]]]:
    """Names and constant keyword arguments of all calls."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call):
            words = {word.arg: getattr(word.value, "value", None) for word in node.keywords if word.arg}
            yield ast.unparse(node.func), words


def dangers(text: str) -> list[str]:
    found = []
    for name, words in calls(text):
        if name in ("pickle.load", "pickle.loads", "pickle.Unpickler", "joblib.load", "dill.load", "marshal.loads"):
            found.append(name)
        if name == "torch.load" and words.get("weights_only") is not True:
            found.append("torch.load without weights_only")
        if words.get("allow_pickle") or words.get("trust_remote_code") or words.get("weights_only") is False:
            found.append(f"{name} that trusts")
        if name in ("torch.hub.load", "eval", "exec"):
            found.append(name)
    return found


def test_no_file_is_trusted() -> None:
    found = {file.relative_to(SOURCES).as_posix(): dangers(file.read_text("utf-8")) for file in SOURCES.rglob("*.py")}
    assert len(found) > 100
    assert {name: what for name, what in found.items() if what} == {}


@pytest.mark.parametrize(
    "text",
    ["torch.load(p)", "torch.load(p, weights_only=False)", "np.load(p, allow_pickle=True)", "pickle.loads(b)"]
    + ["torch.hub.load(r, m)", "M.from_pretrained(p, trust_remote_code=True)"],
)
def test_the_check_sees(text: str) -> None:
    assert dangers(text)
    assert not dangers("torch.load(p, weights_only=True); np.load(p)")
