# SPDX-License-Identifier: Apache-2.0
"""Killed at every touch of the disk, on a full one, on one that may not be written, and by damage of any kind."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from skymoor.errors import InputError
from skymoor.store import Store
from skymoor.store._cache import CHECKSUM_BYTES
from support.interrupted import KILLED, processes, started, status_of, with_room_for, work, work_until
from support.plain_stages import drawn


def products(out: Path) -> dict[str, bytes]:
    """All files but the cache, whose files hold the seconds that they took."""
    found = {path.relative_to(out).as_posix(): path for path in out.rglob("*") if path.is_file()}
    return {name: path.read_bytes() for name, path in found.items() if not name.startswith("stages/")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "out"
    work(out)
    return out


def test_killed_before_any_touch_of_the_disk_it_goes_on_to_the_same_result(whole: Path, tmp_path: Path) -> None:
    """One kill after the other in one folder, each a little later than the last."""
    out, killed = tmp_path / "out", 0
    for count in range(0, 400, 2):
        status = status_of(work_until, out, count)
        if status == 0:
            break
        assert status == KILLED
        killed += 1
    assert killed > 15
    assert products(out) == products(whole)
    assert not list(out.rglob(".skymoor-*"))


def test_killed_at_any_touch_nothing_half_written_stands_in_its_place(whole: Path, tmp_path: Path) -> None:
    """Each kill in a fresh folder: what has a product's name is that product, and a summary comes with all others."""
    expected = products(whole)
    for count in range(0, 400, 3):
        out = tmp_path / f"{count}"
        status = status_of(work_until, out, count)
        found = {name: content for name, content in products(out).items() if ".skymoor-" not in name}
        assert found.items() <= expected.items()
        if "summary.json" in found:
            assert found == expected
        if status == 0:
            return
        assert status == KILLED
    raise AssertionError("it never came to an end")


@pytest.mark.parametrize("size", [1_000, 20_000, 30_000])
def test_a_full_disk_is_told_and_the_next_run_goes_on(size: int, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    ours, theirs = processes().Pipe()
    process = started(with_room_for, work, out, size, theirs)
    kind, message = ours.recv()
    process.join()
    assert kind == "InputError" and "cannot be written: File too large" in message and str(out) in message
    assert not list(out.rglob(".skymoor-*"))
    assert not (out / "summary.json").exists()
    work(out)
    assert products(out) == products(whole)


def damage(place: int) -> Callable[[bytes], bytes]:
    def flip(content: bytes) -> bytes:
        spoilt = bytearray(content)
        spoilt[place] ^= 1
        return bytes(spoilt)

    return flip


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "first byte": damage(0),
    "magic": damage(3),
    "name of an array": damage(32),
    "text": damage(200),
    "numbers": damage(12_000),
    "list of arrays": damage(-100),
    "end of the archive": damage(-CHECKSUM_BYTES - 9),
    "checksum": damage(-20),
    "last byte": damage(-1),
    "empty": lambda content: b"",
    "checksum only": lambda content: content[-CHECKSUM_BYTES:],
    "without its checksum": lambda content: content[:-CHECKSUM_BYTES],
    "cut in the middle": lambda content: content[: len(content) // 2],
    "without its last byte": lambda content: content[:-1],
    "a byte too many": lambda content: content + b"\0",
    "zeros of the right length": lambda content: bytes(len(content)),
    "a hole": lambda content: content[:8000] + bytes(4096) + content[12096:],
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_damage_is_seen_told_and_mended(kind: str, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    (file,) = (out / "stages").glob("first-*")
    file.write_bytes(DAMAGES[kind](file.read_bytes()))
    notes: list[str] = []
    with Store.open(out, note=notes.append) as store:
        np.testing.assert_array_equal(store.stage("first", drawn, 1), drawn(1))
        assert not store.records[0].cached
    assert len(notes) == 1 and "first" in notes[0] and "computed again" in notes[0]


def test_every_byte_of_a_small_stage_counts(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.stage("small", abs, -7)
    (file,) = (tmp_path / "stages").glob("small-*")
    content = file.read_bytes()
    for place in range(0, len(content) * 8, 11):
        spoilt = bytearray(content)
        spoilt[place // 8] ^= 1 << place % 8
        file.write_bytes(spoilt)
        store._records.clear()
        assert store.stage("small", abs, -7) == 7
        assert not store.records[0].cached, f"bit {place} of {len(content)} bytes"


def test_the_file_of_another_stage_is_not_taken(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    (first,), (second,) = ((out / "stages").glob(f"{name}-*") for name in ("first", "second"))
    shutil.copy(second, first)
    notes: list[str] = []
    with Store.open(out, note=notes.append) as store:
        np.testing.assert_array_equal(store.stage("first", drawn, 1), drawn(1))
        assert not store.records[0].cached
    assert len(notes) == 1 and "belongs to something else" in notes[0]


def refusing(number: int) -> Callable[..., None]:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    return refuse


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES, errno.ENOSPC, errno.EDQUOT])
def test_a_folder_that_may_not_be_written_is_told_before_the_work(
    number: int, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Root may write everywhere, hence the pretence."""
    shutil.copytree(whole, tmp_path / "out")
    before = products(tmp_path / "out")
    monkeypatch.setattr("tempfile.TemporaryFile", refusing(number))
    with pytest.raises(InputError, match=rf"out: cannot be written: {os.strerror(number)}"):
        Store.open(tmp_path / "out")
    assert products(tmp_path / "out") == before
    monkeypatch.undo()
    Store.open(tmp_path / "out").close()  # the lock was let go


@pytest.mark.parametrize("call", ["tempfile.mkstemp", "os.fsync", "pathlib.Path.replace", "pathlib.Path.chmod"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_a_disk_that_refuses_while_writing(
    call: str, number: int, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(whole, tmp_path / "out")
    with Store.open(tmp_path / "out") as store:
        monkeypatch.setattr(call, refusing(number))
        with pytest.raises(InputError, match=rf"cameras\.csv: cannot be written: {os.strerror(number)}"):
            store.write_text("cameras.csv", "new")
        monkeypatch.undo()
    assert products(tmp_path / "out") == products(whole)


def test_a_disk_that_became_read_only_hides_not_the_first_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Store.open(tmp_path / "out") as store:
        monkeypatch.setattr("os.fsync", refusing(errno.EIO))
        monkeypatch.setattr("pathlib.Path.unlink", refusing(errno.EROFS))
        with pytest.raises(InputError, match=os.strerror(errno.EIO)):
            store.write_text("a.txt", "x")


def test_a_folder_that_cannot_be_filled_keeps_the_old_one(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "out")

    def fill(folder: Path) -> None:
        (folder / "half").write_text("x")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with Store.open(tmp_path / "out") as store, pytest.raises(InputError, match="air_0: cannot be written: No space"):
        store.write_folder("colmap/air_0", fill)
    assert products(tmp_path / "out") == products(whole)
