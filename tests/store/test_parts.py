# SPDX-License-Identifier: Apache-2.0
"""Results of many large parts: one at a time in memory, on the disk once, and a later run goes on from them."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Sequence
from pathlib import Path
from weakref import WeakSet

import numpy as np
import pytest

from skymoor.errors import InputError
from skymoor.store import Kept, Store, digest
from skymoor.store._cache import Corrupt, read_cache, read_stage, write_cache
from skymoor.types import Gravity

SIDE = 400  # 1.28 MB a part
ALIVE: WeakSet[Gravity] = WeakSet()
RAN: list[str] = []


def part(k: int) -> Gravity:
    """Any dataclass of ours with an array."""
    made = Gravity(np.full((SIDE, SIDE), float(k)), 0.1 * k, 0.0, 0.0, f"part {k}", float("nan"))
    ALIVE.add(made)
    return made


def parts(count: int) -> Iterator[Gravity]:
    RAN.append("parts")
    for k in range(count):
        assert len(ALIVE) <= 2  # the last one is still in the writer's hands
        yield part(k)


def holding(maps: Sequence[Gravity]) -> dict[str, object]:
    RAN.append("holding")
    return {"mean": float(np.mean([one.up[0, 0] for one in maps])), "maps": maps}


@pytest.fixture(autouse=True)
def nothing_ran() -> None:
    RAN.clear()
    ALIVE.clear()


def test_parts_come_back_one_at_a_time(tmp_path: Path) -> None:
    with Store.open(tmp_path / "out") as store:
        kept = store.parts("parts", parts, 6)
    assert isinstance(kept, Kept) and len(kept) == 6 and kept
    assert [one.method for one in kept] == [f"part {k}" for k in range(6)]
    assert kept[-1].up[3, 3] == 5.0 and [one.sigma_deg for one in kept[1:3]] == [0.1, 0.2]
    with pytest.raises(IndexError):
        kept[6]
    assert kept[2] is not kept[2]
    assert digest(kept[2]) == digest(part(2))


def test_what_holds_them_refers_to_their_file_and_a_later_run_finds_both(tmp_path: Path) -> None:
    for _ in range(2):
        with Store.open(tmp_path / "out") as store:
            kept = store.parts("parts", parts, 6)
            found = store.stage("holding", holding, kept.take([1, 3]))
            assert found["mean"] == 2.0
            maps = found["maps"]
            assert isinstance(maps, Kept) and [one.method for one in maps] == ["part 1", "part 3"]
    assert RAN == ["parts", "holding"]
    sizes = {path.name.split("-")[0]: path.stat().st_size for path in (tmp_path / "out/stages").glob("*.npz")}
    assert sizes["parts"] > 6 * 8 * SIDE**2 > 100 * sizes["holding"]
    assert [one.method for one in read_stage(tmp_path / "out", "holding")["maps"]] == ["part 1", "part 3"]


def test_other_parts_are_another_input(tmp_path: Path) -> None:
    for chosen in ([0, 1], [0, 2], [0, 1]):
        with Store.open(tmp_path / "out") as store:
            store.stage("holding", holding, store.parts("parts", parts, 3).take(chosen))
    assert RAN.count("parts") == 1 and RAN.count("holding") == 3


def test_damage_is_noticed_and_computed_again(tmp_path: Path) -> None:
    out, notes = tmp_path / "out", list[str]()
    for _ in range(3):
        with Store.open(out, note=notes.append) as store:
            kept = store.parts("parts", parts, 3)
            store.stage("holding", holding, kept)
        (file,) = (out / "stages").glob("parts-*.npz")
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
    assert RAN.count("parts") == 3 and RAN.count("holding") == 1  # the same parts again
    assert len(notes) == 2 and "is damaged" in notes[0]


def test_a_reference_to_other_parts_or_no_file_of_a_stage_is_not_believed(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        kept = store.parts("parts", parts, 3)
        other = store.parts("other", parts, 2)
        write_cache(tmp_path / "stages/a.npz", None, [kept.take([0])])
    assert [one.method for one in read_cache(tmp_path / "stages/a.npz")[1][0]] == ["part 0"]
    (kept_file,), (other_file,) = (list((tmp_path / "stages").glob(f"{name}-*")) for name in ("parts", "other"))
    other_file.replace(kept_file)
    write_cache(tmp_path / "stages/b.npz", None, {"kept": other})
    kept_file.write_bytes(kept_file.read_bytes())
    # The first parts of both are the same; the third is in one alone.
    write_cache(tmp_path / "stages/c.npz", None, [kept.take([2])])
    with pytest.raises(Corrupt):
        read_cache(tmp_path / "stages/c.npz")
    with pytest.raises(FileNotFoundError):
        read_cache(tmp_path / "stages/b.npz")


def full_disk(count: int) -> Iterator[Gravity]:
    yield from parts(count)
    raise OSError(errno.ENOSPC, "of the work, not of the cache")


def test_errors_of_the_work_stay_what_they_are(tmp_path: Path) -> None:
    with Store.open(tmp_path / "out") as store:
        with pytest.raises(OSError, match="of the work"):
            store.parts("parts", full_disk, 2)
        assert not list((tmp_path / "out/stages").glob("parts*"))
        with pytest.raises(TypeError, match="cannot be kept"):
            store.parts("parts", unkept)
        assert not list((tmp_path / "out/stages").glob("*part*"))


def unkept() -> list[object]:
    return [object()]


def test_a_full_disk_is_that_of_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with Store.open(tmp_path / "out") as store:
        monkeypatch.setattr(np.lib.format, "write_array", refuse)
        with pytest.raises(InputError, match=r"parts-.*cannot be written: No space left"):
            store.parts("parts", parts, 2)
