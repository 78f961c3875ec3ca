# SPDX-License-Identifier: Apache-2.0
"""Disks that are full where other people's code writes: COLMAP, SQLite and OpenCV do not say so by themselves."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

import pycolmap
import pytest

from support.interrupted import processes, started, with_room_for, write_model
from support.tiny_site import Case, assert_refused, make_site, run


@pytest.mark.parametrize("size", [50, 1_000, 20_000, 100_000])
def test_a_colmap_model_is_whole_or_not_there(size: int, tmp_path: Path) -> None:
    ours, theirs = processes().Pipe()
    process = started(with_room_for, write_model, tmp_path, size, theirs)
    kind, message = ours.recv()
    process.join()
    assert kind == "InputError" and "air_0: cannot be written: " in message
    assert not list((tmp_path / "colmap").iterdir())
    write_model(tmp_path)
    assert max(path.stat().st_size for path in (tmp_path / "colmap/air_0").iterdir()) > 100_000


def test_no_room_for_grey_copies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    site = make_site(tmp_path)
    real = Path.write_bytes

    def full(path: Path, content: bytes) -> int:
        if "000002" in path.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return real(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    assert_refused(site, Case("", lambda _: None, ("000002", "No space", "TMPDIR")), lambda: capsys.readouterr().err)
    monkeypatch.undo()
    assert run(site) == 3


@pytest.mark.parametrize("words", ["[database.cc] SQLite error: database or disk is full", "No registered factory"])
def test_no_room_for_the_database(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise RuntimeError(words)

    def usage(path: str) -> object:
        return type("Usage", (), {"free": 4096})

    monkeypatch.setattr(pycolmap.Database, "open", full)
    monkeypatch.setattr("skymoor.reconstruct.mapping.disk_usage", usage)
    case = Case("", lambda _: None, (tempfile.gettempdir(), "no space left", "TMPDIR"))
    assert_refused(make_site(tmp_path), case, lambda: capsys.readouterr().err)
    monkeypatch.setattr("skymoor.reconstruct.mapping.disk_usage", lambda path: type("Usage", (), {"free": 1 << 40}))
    if "full" not in words:
        with pytest.raises(RuntimeError, match=words):  # something else is wrong, and is ours
            run(tmp_path)
