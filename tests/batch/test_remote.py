# SPDX-License-Identifier: Apache-2.0
"""Results at an address: fetched before a run, sent after it, and never half of them in place of the whole."""

from __future__ import annotations

import copy
import json
import pickle
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from skymoor.batch.remote import PART, Address, fetch_folder, folder_of, path_or_address, send_bytes
from skymoor.cli.main import main
from skymoor.engines.temporary import remove_temporary
from skymoor.errors import BackendUnavailable, InputError
from support.tiny_site import make_site

fsspec = pytest.importorskip("fsspec", reason="needs skymoor[dask]")
from fsspec.implementations.local import LocalFileSystem  # noqa: E402


class Breaking(LocalFileSystem):
    """A store on the disk that notes what is done, and breaks off in the middle of one file."""

    protocol = "breaking"
    cachable = False
    done: tuple[str, ...] = ()
    breaks_at = ""

    def __init__(self, **more: Any) -> None:
        super().__init__(auto_mkdir=True, **more)

    def put_file(self, path1: str, path2: str, callback: object = None, **more: Any) -> None:
        name = path2.removesuffix(PART)
        if self.breaks_at and name.endswith(self.breaks_at):
            Path(path2).write_bytes(b"half")
            raise ConnectionResetError("the line is gone")
        self.note("put", name)
        super().put_file(path1, path2, **more)

    def rm_file(self, path: str) -> None:
        self.note("delete", path)
        super().rm_file(path)

    def note(self, what: str, path: str) -> None:
        type(self).done = (*self.done, f"{what} {path.rpartition('/bucket/')[2]}")


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Address:
    """Its address."""
    fsspec.register_implementation("breaking", Breaking, clobber=True)
    monkeypatch.setattr(Breaking, "done", ())
    monkeypatch.setattr(Breaking, "breaks_at", "")
    return Address(f"breaking://{tmp_path / 'bucket'}")


@pytest.fixture
def memory() -> Iterator[Address]:
    files = fsspec.filesystem("memory")
    yield Address("memory://batch")
    files.rm("/batch", recursive=True)


def fill(folder: Path) -> None:
    """As a run would."""
    (folder / "stages").mkdir(exist_ok=True)
    for name in ("summary.json", "cameras.csv", "report.html", ".lock", "stages/a.npz"):
        (folder / name).write_text(name)


def names(store: Address) -> list[str]:
    root = Path(store.partition("://")[2])
    return sorted(path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file())


def test_folders_and_addresses_are_told_apart_and_joined(tmp_path: Path) -> None:
    assert path_or_address("some/folder") == Path("some/folder")
    address = path_or_address("s3://bucket/results/")
    assert isinstance(address, Address) and address / "a" == "s3://bucket/results/a"
    assert path_or_address("memory://") / "a" == "memory://a"
    assert pickle.loads(pickle.dumps(address)) == copy.deepcopy(address) == address
    with folder_of(tmp_path / "new") as folder:
        assert folder == tmp_path / "new" and folder.is_dir()


def test_the_summary_is_last_and_only_what_changed_is_sent(store: Address) -> None:
    with folder_of(store) as folder:
        fill(folder)
    assert Breaking.done == ("put stages/a.npz", "put cameras.csv", "put report.html", "put summary.json")
    Breaking.done = ()
    with folder_of(store) as folder:
        assert (folder / "stages/a.npz").read_text() == "stages/a.npz" and not (folder / ".lock").exists()
        (folder / "cameras.csv").write_text("others")
        (folder / "summary.json").write_text("of others")
        (folder / "stages/a.npz").rename(folder / "stages/b.npz")
    deleted = ("delete stages/a.npz", "delete summary.json")  # before there is any product of another run
    assert Breaking.done == ("put stages/b.npz", *deleted, "put cameras.csv", "put summary.json")
    assert names(store) == ["cameras.csv", "report.html", "stages/b.npz", "summary.json"]


def test_a_copy_that_breaks_off_replaces_nothing(store: Address, tmp_path: Path) -> None:
    with folder_of(store) as folder:
        fill(folder)
    Breaking.breaks_at = "cameras.csv"
    broken = r"cannot be written .*the line is gone.*the same command continues"
    with pytest.raises(InputError, match=broken), folder_of(store) as folder:
        (folder / "cameras.csv").write_text("new")
    bucket = Path(store.partition("://")[2])
    assert (bucket / "cameras.csv").read_text() == "cameras.csv" and f"cameras.csv{PART}" in names(store)
    assert f"cameras.csv{PART}" not in fetch_folder(store, tmp_path / "again")
    assert f"cameras.csv{PART}" not in names(store)  # the next one clears it away


def test_the_end_of_the_process_deletes_nothing_there(store: Address) -> None:
    """A signal removes temporary folders while other threads still work with them."""
    with folder_of(store) as folder:
        fill(folder)
    before = names(store)
    with pytest.raises(InputError, match="nothing was sent"), folder_of(store) as folder:
        remove_temporary()
    assert names(store) == before
    with pytest.raises(KeyboardInterrupt), folder_of(store) as folder:
        shutil.rmtree(folder)
        raise KeyboardInterrupt
    assert names(store) == before


def test_files_outside_of_the_folder_are_not_written(memory: Address, tmp_path: Path) -> None:
    fsspec.filesystem("memory").store["/batch/../../evil"] = fsspec.implementations.memory.MemoryFile(
        fsspec.filesystem("memory"), "/batch/../../evil", b"x"
    )
    with pytest.raises(InputError, match="lies outside"):
        fetch_folder(memory, tmp_path / "in/folder")
    assert not (tmp_path / "evil").exists()


def test_what_a_store_lacks_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"nosuch://b/x: cannot be written .*check the address"):
        send_bytes(b"", Address("nosuch://b/x"))

    def missing(name: str) -> object:
        raise ImportError(f"no module {name}")

    monkeypatch.setattr(fsspec.core, "url_to_fs", lambda *_, **__: missing("s3fs"))
    with pytest.raises(InputError, match=r"s3fs.*install that package"):
        send_bytes(b"", Address("s3://b/x"))
    monkeypatch.setattr("skymoor.engines.libraries.importlib.import_module", missing)
    with pytest.raises(BackendUnavailable, match=r"fsspec.*skymoor\[dask\]"):
        send_bytes(b"", Address("s3://b/x"))


def test_without_fsspec_the_command_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    assert main(["batch", str(make_site(tmp_path / "a")), "--out", "s3://b/x", "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("skymoor: fsspec.core cannot be imported") and "skymoor[dask]" in line


def test_a_batch_goes_on_from_its_address(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = make_site(tmp_path / "sites/a")
    shutil.copytree(first, tmp_path / "sites/broken")
    (tmp_path / "sites/broken/ortho.tif").unlink()
    results = tmp_path / "results"
    command = ["batch", str(tmp_path / "sites"), "--out", f"file://{results}", "--workers", "2", "--quiet"]
    assert main([*command, "--stop-after", "reconstruct"]) == 2
    assert "without --stop-after goes on from there" in capsys.readouterr().out
    state = json.loads((results / "batch.json").read_text())
    assert [one["verdict"] for one in state["sites"]] == ["STOPPED", "BAD_INPUT"]
    assert [one["stopped_after"] for one in state["sites"]] == ["reconstruct", None]
    assert list((results / "a/stages").glob("reconstruct-*.npz")) and not (results / "a/summary.json").exists()
    assert (results / "broken/batch.log").is_file()  # also of what failed
    assert main([*command, "--only", "a"]) == 3
    stages = json.loads((results / "a/summary.json").read_text())["stages"]
    assert all(one["cached"] for one in stages if one["name"] in ("photos", "reference", "reconstruct"))
    page = (results / "batch.html").read_text()
    assert 'href="a/report.html"' in page and "NOT_REGISTERED" in page
    (one,) = json.loads((results / "batch.json").read_text())["sites"]
    assert one["out"] == f"file://{results}/a" and f"to read: file://{results}/batch.html" in capsys.readouterr().out


def test_any_store_will_do_such_as_that_of_this_process(memory: Address, tmp_path: Path) -> None:
    make_site(tmp_path / "sites/a")
    command = ["batch", str(tmp_path / "sites"), "--out", memory, "--quiet"]
    assert main([*command, "--stop-after", "reconstruct"]) == 0
    files = fsspec.filesystem("memory")
    assert json.loads(files.cat("/batch/batch.json"))["sites"][0]["verdict"] == "STOPPED"
    assert files.exists("/batch/a/run.log") and files.exists("/batch/batch.html")
    assert not [path for path in files.find("/batch") if path.endswith((".lock", PART))]


def test_a_store_that_refuses_fails_the_site_alone(store: Address, tmp_path: Path) -> None:
    make_site(tmp_path / "sites/a")
    Breaking.breaks_at = "/a/batch.log"
    command = ["batch", str(tmp_path / "sites"), "--out", store / "out", "--stop-after", "reconstruct", "--quiet"]
    assert main(command) == 2
    (one,) = json.loads((tmp_path / "bucket/out/batch.json").read_text())["sites"]
    assert one["verdict"] == "BAD_INPUT" and "the line is gone" in one["message"]
