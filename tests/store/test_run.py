# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import errno
import json
import multiprocessing
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from PIL import Image

from skymoor.errors import InputError
from skymoor.store import FROM_CACHE, Store

VALUE = np.arange(1000)


@dataclass(frozen=True)
class Step:
    gain: float = 2.0


@dataclass(frozen=True)
class Stage:
    """A stage that returns `value`, and notes that it ran."""

    name: str
    value: object = None
    ran: ClassVar[list[str]] = []

    def __call__(self, *inputs: object, **options: object) -> object:
        self.ran.append(self.name)
        return self.value


@pytest.fixture(autouse=True)
def nothing_ran() -> None:
    Stage.ran.clear()


def crash(*_: object) -> int:
    raise RuntimeError("crash")


def nothing_that_is_kept(_: int) -> object:
    return crash


def heavy() -> int:
    return int(np.ones(40_000_000, np.uint8).sum())


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "out"


@pytest.fixture
def store(out: Path) -> Iterator[Store]:
    with Store.open(out) as opened:
        yield opened


def run(out: Path, first: Step, second: Step, notes: list[str] | None = None) -> list[bool]:
    """Two chained stages and one on its own; which of them came from the cache."""
    with Store.open(out, note=(notes if notes is not None else []).append) as store:
        made = store.stage("first", scaled, VALUE, first)
        np.testing.assert_array_equal(made, first.gain * VALUE)
        store.stage("second", Stage("second", {"a": 1}), made, options=second)
        store.stage("alone", Stage("alone"))
        return [record.cached for record in store.records]


def scaled(x: np.ndarray, step: Step) -> np.ndarray:
    return step.gain * x


def test_second_run_computes_nothing(out: Path) -> None:
    assert run(out, Step(), Step()) == [False, False, False]
    assert run(out, Step(), Step()) == [True, True, True]
    assert Stage.ran == ["second", "alone"]


def test_what_comes_from_the_cache_says_so(out: Path) -> None:
    told: list[tuple[int, int, str]] = []

    def progress(done: int, total: int, note: str = "", /) -> None:
        told.append((done, total, note))

    for _ in range(2):
        with Store.open(out) as store:
            store.stage("heavy", Stage("heavy", 1), progress=progress)
    assert told == [(0, 1, ""), (1, 1, FROM_CACHE)]


def test_changed_option_recomputes_only_downstream(out: Path) -> None:
    run(out, Step(), Step())
    assert run(out, Step(), Step(3.0)) == [True, False, True]
    assert run(out, Step(3.0), Step(3.0)) == [False, False, True]


def test_what_comes_out_the_same_changes_nothing_downstream(out: Path) -> None:
    """Keys are made of results: another way to the same one is no reason to compute on."""
    with Store.open(out) as store:
        store.stage("second", Stage("second"), store.stage("first", scaled, VALUE, Step()))
    with Store.open(out) as store:
        store.stage("second", Stage("second"), store.stage("first", np.multiply, 2.0, VALUE))
        assert [record.cached for record in store.records] == [False, True]


def test_progress_and_checkpoints_count_for_nothing(out: Path) -> None:
    for name, cached in (("a", False), ("b", True)):
        with Store.open(out) as store:
            own = {"progress": lambda *_: None, "checkpoint": out / name}
            store.stage("work", Stage("work"), VALUE, **own)
            assert store.records[0].cached is cached


def test_old_results_of_a_stage_are_removed_and_others_kept(out: Path) -> None:
    with Store.open(out) as store:
        store.stage("match", abs, 1)
        store.stage("match-air", abs, 2)
    (out / "stages/match-0123456789ab.npz").touch()  # of another key
    with Store.open(out) as store:
        store.stage("match", abs, 3)
    names = sorted(file.name.rpartition("-")[0] for file in (out / "stages").glob("*-*"))
    assert names == ["match", "match-air"]


def test_a_file_counts_by_what_it_holds(out: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "a.tif", tmp_path / "b.tif"
    first.write_bytes(b"1")
    second.write_bytes(b"1")
    os.utime(second, ns=(0, 1))
    for content, file, cached in ((None, first, False), (None, second, True), (b"2", second, False)):
        if content:
            second.write_bytes(content)
        with Store.open(out) as store:
            store.stage("read", Stage("read"), file, depends_on=[file])
            assert store.records[0].cached is cached


def test_local_functions_are_refused(store: Store) -> None:
    with pytest.raises(ValueError, match="not a local function"):
        store.stage("work", lambda: 1)


def test_costs_survive_resuming(out: Path) -> None:
    for _ in range(2):
        with Store.open(out) as store:
            store.stage("heavy", heavy)
            record = store.records[0]
    assert record.cached
    assert 0 < record.seconds < 60
    assert 40 < record.peak_mib < 100_000


def test_the_cache_is_freed_and_the_results_stay(out: Path) -> None:
    with Store.open(out) as store:
        store.stage("work", scaled, VALUE, Step())
        store.write_text("summary.json", "{}")
        held = sum(file.stat().st_size for file in (out / "stages").iterdir())
        assert store.clean() == held > VALUE.nbytes
    assert (out / "summary.json").is_file() and not list((out / "stages").glob("work-*"))
    with Store.open(out) as store:
        store.stage("work", scaled, VALUE, Step())
        assert not store.records[0].cached


@pytest.mark.parametrize("damage", ["truncate", "flip", "empty"])
def test_damaged_cache_is_computed_again_with_a_note(out: Path, damage: str) -> None:
    notes = list[str]()
    run(out, Step(), Step())
    file = next((out / "stages").glob("first-*"))
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1  # within the numbers, where nothing else would notice
    file.write_bytes({"truncate": content[:-30], "flip": content, "empty": b""}[damage])
    assert run(out, Step(), Step(), notes) == [False, True, True]
    assert len(notes) == 1
    assert "first" in notes[0]
    assert run(out, Step(), Step(), notes) == [True, True, True]
    assert len(notes) == 1


def test_failing_stage_leaves_nothing_and_keeps_the_old_result(out: Path) -> None:
    with Store.open(out) as store:
        store.stage("work", abs, 1)
    with Store.open(out) as store, pytest.raises(RuntimeError):
        store.stage("work", crash, 2)
    with Store.open(out) as store, pytest.raises(TypeError, match="cannot be kept"):
        store.stage("work", nothing_that_is_kept, 3)
    assert [file.name for file in out.rglob("*.tmp")] == []
    with Store.open(out) as store:
        assert store.stage("work", abs, 1) == 1
        assert store.records[0].cached


def test_stage_names_are_used_once_and_plain(store: Store) -> None:
    store.stage("a", abs, 1)
    for name in ("a", "A b", "../a", ""):
        with pytest.raises(ValueError, match="stage name"):
            store.stage(name, abs, 1)


def _write_and_die(out: str) -> None:
    def fill(folder: Path) -> None:
        (folder / "half").write_text("x")
        os._exit(9)

    Store.open(Path(out)).write_folder("colmap/air_0", fill)


def test_killed_in_the_middle_leaves_the_old_product_and_no_rubbish(out: Path) -> None:
    with Store.open(out) as store:
        store.write_folder("colmap/air_0", lambda folder: (folder / "whole").write_text("old") and None)
    process = multiprocessing.get_context("spawn").Process(target=_write_and_die, args=(str(out),))
    process.start()
    process.join()
    assert process.exitcode == 9
    assert len(list((out / "colmap").glob(".skymoor-*"))) == 1
    with Store.open(out):  # the lock died with the process
        pass
    assert [path.name for path in (out / "colmap").iterdir()] == ["air_0"]
    assert [path.name for path in (out / "colmap/air_0").iterdir()] == ["whole"]


def test_full_disk_leaves_the_old_file(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    store.write_text("a.txt", "old")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match=r"a\.txt: cannot be written: No space left"):
        store.write_text("a.txt", "new")
    assert store.path("a.txt").read_text() == "old"
    assert not list(store.root.rglob("*.tmp"))


def test_folder_is_replaced_as_a_whole(store: Store) -> None:
    for name in ("one", "two"):
        store.write_folder("colmap/air_0", lambda folder, name=name: (folder / name).write_text("") and None)
    assert [path.name for path in store.path("colmap", "air_0").iterdir()] == ["two"]
    assert [path.name for path in store.path("colmap").iterdir()] == ["air_0"]
    store.remove("colmap")
    store.remove("colmap")
    assert not store.path("colmap").exists()


def test_one_run_at_a_time(out: Path) -> None:
    with Store.open(out), pytest.raises(InputError, match="another run"):
        Store.open(out)
    Store.open(out).close()


def test_out_must_be_a_folder_that_can_be_made(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(InputError, match="is a file"):
        Store.open(file)
    with pytest.raises(InputError, match="cannot be written"):
        Store.open(file / "below")


def test_products(store: Store) -> None:
    value = {"nan": float("nan"), "n": np.int64(3), "x": np.array([1.5, np.inf]), "step": Step(), "path": Path("a/b")}
    written = json.loads(store.write_json("summary.json", value).read_text())
    assert written == {"nan": None, "n": 3, "x": [1.5, None], "step": {"gain": 2.0}, "path": "a/b"}
    rows = [{"image": "a, b.jpg", "x": 1 / 3}, {"image": "c", "x": None}]
    table = store.write_csv("t.csv", ("image", "x"), rows).read_text()
    assert table == f'image,x\n"a, b.jpg",{1 / 3!r}\nc,\n'
    rgb = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    with Image.open(store.write_png("renders/a.png", rgb)) as image:
        np.testing.assert_array_equal(np.asarray(image), rgb)
    with np.load(store.write_npz("matches/a.npz", px=np.eye(2))) as arrays:
        np.testing.assert_array_equal(arrays["px"], np.eye(2))
    mode = store.write_text("a.txt", "hé").stat().st_mode & 0o777
    assert mode == 0o666 & ~_umask()
    assert not list(store.root.rglob("*.tmp"))


def test_products_stay_inside(store: Store) -> None:
    with pytest.raises(ValueError, match="outside"):
        store.write_text("../a.txt", "")
    with pytest.raises(TypeError, match="JSON"):
        store.write_json("a.json", {"f": _umask})
    with pytest.raises(TypeError, match="objects"):
        store.write_npz("a.npz", a=np.array([None]))
    store.write_text("plain", "")
    with pytest.raises(InputError, match="cannot be written"):
        store.write_text("plain/below", "")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
