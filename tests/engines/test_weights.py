# SPDX-License-Identifier: Apache-2.0
"""Pretrained weights: found, fetched and read, or one line that says what is wrong and what to do."""

from __future__ import annotations

import hashlib
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from zipfile import ZipFile

import pytest
import torch

import skymoor.engines.weights.table
from skymoor.cli.main import main
from skymoor.engines.weights import (
    KNOWN,
    WeightFile,
    Weights,
    fetch,
    find,
    known,
    load_into,
    load_state_dict,
    verify,
    weights_folder,
)
from skymoor.errors import BackendUnavailable, InputError
from support.trap import Trap


def network(seed: int = 0, width: int = 4) -> torch.nn.Module:
    torch.manual_seed(seed)
    return torch.nn.Sequential(torch.nn.Linear(3, width), torch.nn.Linear(width, 1))


def saved(path: Path, content: object) -> Path:
    torch.save(content, path)
    return path


def quiet(name: str) -> Callable[[int, int], object]:
    return lambda done, total: None


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkpoint that is known as "toy", with its digest, at a local address."""
    path = saved(tmp_path / "origin.pth", network().state_dict())
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    file = WeightFile("toy.pth", path.as_uri(), 0.1, digest)
    toy = Weights("toy", "nothing", (file,), "MIT", "MIT")
    monkeypatch.setattr(skymoor.engines.weights.table, "KNOWN", (toy,))
    return path


class TestTable:
    def test_names_are_unique_and_addresses_are_safe(self) -> None:
        assert len({one.name for one in KNOWN}) == len(KNOWN)
        for one in KNOWN:
            assert one.code_licence and one.weights_licence
            for file in one.files:
                assert file.url.startswith("https://")
                assert file.sha256 is None or len(file.sha256) == 64
                assert not Path(file.file).is_absolute() and ".." not in file.file

    def test_unknown_name(self) -> None:
        with pytest.raises(InputError, match=r"nothing: no weights .* skymoor weights list"):
            known("nothing")


class TestFind:
    def test_folder_of_the_environment_and_of_the_user(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("SKYMOOR_WEIGHTS", "/some/where")
        assert weights_folder() == Path("/some/where")
        monkeypatch.delenv("SKYMOOR_WEIGHTS")
        monkeypatch.setenv("XDG_DATA_HOME", "/data")
        assert weights_folder() == Path("/data/skymoor/weights")
        monkeypatch.delenv("XDG_DATA_HOME")
        monkeypatch.setenv("HOME", "/home/somebody")
        assert weights_folder() == Path("/home/somebody/.local/share/skymoor/weights")

    def test_given_and_fetched(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        given = saved(tmp_path / "mine.pth", {})
        assert find("roma", "roma_outdoor.pth", given) == given
        monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path))
        with pytest.raises(BackendUnavailable, match=r"roma_outdoor\.pth.*skymoor weights fetch roma$"):
            find("roma", "roma_outdoor.pth")
        (tmp_path / "roma").mkdir()
        fetched = saved(tmp_path / "roma/roma_outdoor.pth", {})
        assert find("roma", "roma_outdoor.pth", "") == fetched

    def test_given_but_not_there(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"mine\.pth: there are no weights here.*roma_outdoor\.pth"):
            find("roma", "roma_outdoor.pth", tmp_path / "mine.pth")


class TestFetch:
    def test_whole_and_checked(self, source: Path, tmp_path: Path) -> None:
        steps = []
        (done,) = fetch("toy", tmp_path / "weights", lambda name: lambda n, of: steps.append((name, n, of)))
        assert done.path == tmp_path / "weights/toy/toy.pth" and not done.was_there
        assert done.path.read_bytes() == source.read_bytes()
        assert done.sha256 == hashlib.sha256(source.read_bytes()).hexdigest()
        assert steps[-1] == ("toy.pth", 1, 1)
        assert [path.name for path in done.path.parent.iterdir()] == ["toy.pth"]

    def test_a_good_file_is_left_alone(self, source: Path, tmp_path: Path) -> None:
        fetch("toy", tmp_path, quiet)
        before = (tmp_path / "toy/toy.pth").stat()
        (again,) = fetch("toy", tmp_path, quiet)
        assert again.was_there and (tmp_path / "toy/toy.pth").stat().st_ino == before.st_ino

    def test_a_wrong_file_is_neither_overwritten_nor_believed(self, source: Path, tmp_path: Path) -> None:
        (tmp_path / "toy").mkdir()
        mine = tmp_path / "toy/toy.pth"
        mine.write_text("mine")
        with pytest.raises(InputError, match=r"toy\.pth: not the expected file \(sha256 .*expected .*delete it"):
            fetch("toy", tmp_path, quiet)
        assert mine.read_text() == "mine"

    def test_another_file_at_the_address(self, source: Path, tmp_path: Path) -> None:
        source.write_bytes(source.read_bytes()[:-1] + b"x")
        with pytest.raises(InputError, match=r"origin\.pth: not the file that skymoor knows"):
            fetch("toy", tmp_path / "weights", quiet)
        assert not list((tmp_path / "weights/toy").iterdir())

    def test_nothing_at_the_address(self, source: Path, tmp_path: Path) -> None:
        source.unlink()
        with pytest.raises(InputError, match=r"cannot be fetched.*by hand at .*toy/toy\.pth$"):
            fetch("toy", tmp_path / "weights", quiet)
        assert not list((tmp_path / "weights/toy").iterdir())

    def test_interrupted(self, source: Path, tmp_path: Path) -> None:
        def stop(name: str) -> Callable[[int, int], object]:
            def interrupt(done: int, total: int) -> None:
                raise KeyboardInterrupt

            return interrupt

        with pytest.raises(KeyboardInterrupt):
            fetch("toy", tmp_path / "weights", stop)
        assert not list((tmp_path / "weights/toy").iterdir())

    def test_addresses_of_other_kinds_are_refused(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        file = WeightFile("toy.pth", "http://localhost/toy.pth", 1)
        monkeypatch.setattr(skymoor.engines.weights.table, "KNOWN", (Weights("toy", "", (file,), "MIT", "MIT"),))
        with pytest.raises(InputError, match="https or file addresses only"):
            fetch("toy", tmp_path, quiet)

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            ("good", ""),
            ("other", r"box\.zip: parts/toy\.pth is not the file that skymoor knows"),
            ("empty", r"box\.zip: not the archive that skymoor knows \(.*parts/toy\.pth.*\); nothing is kept"),
            ("cut off", r"box\.zip: not the archive that skymoor knows"),
        ],
    )
    def test_out_of_an_archive(
        self, content: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        box, inside = tmp_path / "box.zip", {"good": b"numbers", "other": b"others"}.get(content)
        with ZipFile(box, "w") as archive:
            archive.writestr("parts/toy.pth" if inside else "readme", inside or b"numbers")
        if content == "cut off":
            box.write_bytes(box.read_bytes()[:-30])
        digest = hashlib.sha256(b"numbers").hexdigest()
        file = WeightFile("toy.pth", box.as_uri(), 1, digest, member="parts/toy.pth")
        monkeypatch.setattr(skymoor.engines.weights.table, "KNOWN", (Weights("toy", "", (file,), "MIT", "MIT"),))
        if message:
            with pytest.raises(InputError, match=message):
                fetch("toy", tmp_path / "weights", quiet)
            assert not list((tmp_path / "weights/toy").iterdir())
            return
        (done,) = fetch("toy", tmp_path / "weights", quiet)
        assert done.path.read_bytes() == b"numbers" and done.sha256 == digest
        assert [path.name for path in done.path.parent.iterdir()] == ["toy.pth"]

    def test_repository_without_the_hubs_library(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "huggingface_hub", None)
        with pytest.raises(BackendUnavailable, match=r"pip install huggingface_hub.*by hand in .*marigold/model$"):
            fetch("marigold", tmp_path, quiet)
        assert not list((tmp_path / "marigold").iterdir())

    @pytest.mark.parametrize("broken", [False, True])
    def test_repository(self, broken: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def snapshot_download(repository: str, *, local_dir: Path, ignore_patterns: list[str]) -> None:
            assert repository == "prs-eth/marigold-depth-v1-1" and "*.fp16.*" in ignore_patterns
            (local_dir / ".cache").mkdir(parents=True)
            (local_dir / "model_index.json").write_text("{}")
            if broken:
                raise OSError("We cannot reach the hub.\nMore lines.")

        library = SimpleNamespace(snapshot_download=snapshot_download)
        monkeypatch.setitem(sys.modules, "huggingface_hub", library)
        if broken:
            with pytest.raises(
                InputError, match=r"cannot be fetched \(We cannot reach the hub\.\); try again"
            ) as caught:
                fetch("marigold", tmp_path, quiet)
            assert "\n" not in str(caught.value) and not list((tmp_path / "marigold").iterdir())
            return
        (done,) = fetch("marigold", tmp_path, quiet)
        assert done.path == tmp_path / "marigold/model" and done.sha256 is None
        assert [path.name for path in done.path.iterdir()] == ["model_index.json"]


class TestRead:
    def test_round_trip_into_a_network(self, tmp_path: Path) -> None:
        trained, fresh = network(1), network(2)
        load_into(fresh, saved(tmp_path / "net.pth", trained.state_dict()))
        x = torch.linspace(0, 1, 3)
        assert torch.equal(fresh(x), trained(x))

    def test_part_of_a_checkpoint(self, tmp_path: Path) -> None:
        path = saved(tmp_path / "net.ckpt", {"epoch": 3, "state_dict": network(1).state_dict()})
        assert set(load_state_dict(path, part="state_dict")) == set(network().state_dict())
        with pytest.raises(InputError, match="not of a network's weights alone"):
            load_state_dict(path)

    def test_constants_may_be_missing(self, tmp_path: Path) -> None:
        tensors = network(1).state_dict()
        del tensors["1.bias"]
        path = saved(tmp_path / "net.pth", tensors)
        load_into(network(2), path, may_miss=["1.bias"])
        with pytest.raises(InputError, match=r"net\.pth: weights of another network \(lacks 1\.bias\)"):
            load_into(network(2), path)

    def test_another_network(self, tmp_path: Path) -> None:
        path = saved(tmp_path / "net.pth", network(width=5).state_dict())
        with pytest.raises(InputError, match=r"net\.pth: weights of another network \(size mismatch") as caught:
            load_into(network(), path)
        assert "\n" not in str(caught.value)

    def test_more_than_the_network_has(self, tmp_path: Path) -> None:
        path = saved(tmp_path / "net.pth", {**network().state_dict(), "more": torch.zeros(1)})
        with pytest.raises(InputError, match=r"\(holds more\)"):
            load_into(network(), path)

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
    def test_cut_off(self, tmp_path: Path, share: float) -> None:
        path = saved(tmp_path / "net.pth", network().state_dict())
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError, match=r"net\.pth: (cut off|not a checkpoint)") as caught:
            load_state_dict(path)
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize("content", [b"<html>404</html>", b"version https://git-lfs.github.com/spec/v1\n"])
    def test_no_checkpoint(self, tmp_path: Path, content: bytes) -> None:
        (tmp_path / "net.pth").write_bytes(content)
        with pytest.raises(InputError, match=r"net\.pth: .*not a checkpoint"):
            load_state_dict(tmp_path / "net.pth")

    @pytest.mark.parametrize("legacy", [False, True])
    def test_code_is_not_run(self, tmp_path: Path, legacy: bool) -> None:
        path = tmp_path / "net.pth"
        trap = Trap(tmp_path / "sprung")
        if legacy:
            path.write_bytes(pickle.dumps(trap, protocol=2))
        else:
            saved(path, {"weight": trap})
        with pytest.raises(InputError, match=r"net\.pth: holds code"):
            load_state_dict(path)
        assert not (tmp_path / "sprung").exists()

    def test_numbers_that_are_no_tensors(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"net\.pth"):
            load_state_dict(saved(tmp_path / "net.pth", [1, 2, 3]))

    def test_missing(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"net\.pth: there is no such file"):
            load_state_dict(tmp_path / "net.pth")

    def test_safetensors(self, tmp_path: Path) -> None:
        from safetensors.torch import save_file

        path = tmp_path / "net.safetensors"
        save_file(network(1).state_dict(), path)
        assert torch.equal(load_state_dict(path)["1.bias"], network(1).state_dict()["1.bias"])
        path.write_bytes(path.read_bytes()[:-20])
        with pytest.raises(InputError, match=r"net\.safetensors: cut off"):
            load_state_dict(path)

    def test_digest(self, tmp_path: Path) -> None:
        (tmp_path / "file").write_bytes(b"abc")
        digest = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        verify(tmp_path / "file", digest)
        with pytest.raises(InputError, match=digest[1:]):
            verify(tmp_path / "file", digest[::-1])


class TestCommands:
    def test_list_says_what_is_here(
        self, source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path / "weights"))
        (tmp_path / "weights/tiny-roma").mkdir(parents=True)
        saved(tmp_path / "weights/tiny-roma/tiny_roma_v1_outdoor.pth", {})
        assert main(["weights", "list"]) == 0
        text = capsys.readouterr().out
        lines = {
            cells[0]: cells
            for cells in ([c.strip() for c in line.split("│")[1:]] for line in text.splitlines())
            if cells
        }
        assert all(one.name in lines for one in KNOWN)
        assert lines["tiny-roma"][3] == "yes" and lines["roma"][3] == "no"
        assert "not known" in lines["roma"][6]

    def test_fetch(
        self, source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.delenv("SKYMOOR_WEIGHTS", raising=False)
        assert main(["weights", "fetch", "toy", "--to", str(tmp_path / "w")]) == 0
        text = capsys.readouterr().out
        assert "toy.pth: fetched, sha256" in text and f"SKYMOOR_WEIGHTS={tmp_path / 'w'}" in text
        assert main(["weights", "fetch", "toy", "--to", str(tmp_path / "w")]) == 0
        assert "was here" in capsys.readouterr().out

    def test_unknown_name_is_one_line(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["weights", "fetch", "nothing"]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
