# SPDX-License-Identifier: Apache-2.0
"""Every engine that reads weights, with everything that can be wrong with them: one line, the path, and the mend."""

from __future__ import annotations

import json
import pickle
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch

import skymoor.densify
import skymoor.match
import skymoor.orient
import skymoor.reconstruct
from skymoor.errors import BackendUnavailable, InputError
from skymoor.match import AnyLocRetriever
from skymoor.orient import OneFormerLabeler
from support.engines import FILES, FOLDERS, Engine
from support.torchvision_parts import draw_nothing, romatch_library
from support.trap import Trap


def each(*engines: Engine) -> Any:
    return pytest.mark.parametrize("engine", engines, ids=lambda engine: engine.kind.__name__)


def case(*functions: Callable[..., str]) -> Any:
    return pytest.mark.parametrize("spoil", functions, ids=lambda function: function.__name__.strip("_"))


def assert_refuses(engine: Engine, path: Path, message: str) -> None:
    """With one line that begins with the path, and that says after it what to do."""
    with pytest.raises(InputError, match=message) as caught:
        engine.call(str(path))
    line = str(caught.value)
    assert line.startswith(str(path)) and "\n" not in line and len(line) < 400 + len(str(path))
    assert "; " in line.removeprefix(str(path))


def test_no_engine_is_forgotten() -> None:
    packages = (skymoor.densify, skymoor.match, skymoor.orient, skymoor.reconstruct)
    public = [kind for package in packages for kind in vars(package).values() if is_dataclass(kind)]
    # COLMAP's own, whose models are a folder, wants a build that is not on PyPI.
    reading = {kind for kind in public if {"weights", "lightglue"} & {field.name for field in fields(kind)}}
    assert reading == {engine.kind for engine in FILES + FOLDERS}


@each(*FILES, *FOLDERS)
def test_neither_library_nor_weights(engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKYMOOR_WEIGHTS", str(tmp_path))
    for library in {engine.library, "transformers"} - {""}:
        monkeypatch.setitem(sys.modules, library, ModuleType(library))
    with pytest.raises(BackendUnavailable, match=f"; fetch them: skymoor weights fetch {engine.weights}$") as caught:
        engine.call("")
    assert str(caught.value).startswith(str(tmp_path / engine.weights)) and "\n" not in str(caught.value)
    if engine.library:
        monkeypatch.setitem(sys.modules, engine.library, None)
        with pytest.raises(
            BackendUnavailable, match=rf'^{engine.library} cannot .* pip install "skymoor\[{engine.extra}\]"$'
        ):
            engine.call("")


@pytest.fixture
def libraries(engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What the engines of files need; RoMa v2 gets a library that loads what the hub gives it, as its own does."""
    draw_nothing(monkeypatch)
    if engine.library == "romatch":
        with romatch_library(monkeypatch):
            yield
        return

    class RoMaV2(torch.nn.Linear):
        Cfg = dict

        def __init__(self, _: object) -> None:
            super().__init__(1, 1)
            self.load_state_dict(torch.hub.load_state_dict_from_url("https://x/romav2.0.1.pt", progress=False))

    romav2 = ModuleType("romav2")
    romav2.RoMaV2 = RoMaV2  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "romav2", romav2)
    (tmp_path / "dinov3").mkdir()
    (tmp_path / "dinov3/hubconf.py").touch()
    yield


def nothing(path: Path) -> str:
    return "there are no weights here; give the path of"


def text(path: Path) -> str:
    path.write_text("<html>404 Not Found</html>\n")
    return "not a checkpoint of PyTorch"


def another_network(path: Path) -> str:
    torch.save({"somewhere.weight": torch.zeros(3, 4), "somewhere.bias": torch.zeros(3)}, path)
    return r"weights of another network \(.+\); is it the right file\?"


def truncated(path: Path) -> str:
    torch.save({"weight": torch.zeros(10_000)}, path)
    path.write_bytes(path.read_bytes()[:-5000])
    return "(cut off|not a checkpoint of PyTorch).*; fetch it again"


def code(path: Path) -> str:
    torch.save({"weight": torch.zeros(3), "hook": Trap(path.parent / "sprung")}, path)
    return "holds code or objects besides numbers, and is not read; get it anew"


def bare_code(path: Path) -> str:
    path.write_bytes(pickle.dumps(Trap(path.parent / "sprung"), protocol=2))
    return "holds code or objects besides numbers, and is not read; get it anew"


@each(*FILES)
@case(nothing, text, another_network, truncated, code, bare_code)
@pytest.mark.usefixtures("libraries")
def test_files(engine: Engine, spoil: Callable[[Path], str], tmp_path: Path) -> None:
    assert_refuses(engine, tmp_path / "weights.pth", spoil(tmp_path / "weights.pth"))
    assert not (tmp_path / "sprung").exists()


def test_the_trap_is_one(tmp_path: Path) -> None:
    """Whoever trusts these files runs what is in them."""
    path = tmp_path / "weights.pth"
    code(path)
    torch.load(path, weights_only=False)
    (tmp_path / "sprung").rmdir()
    bare_code(path)
    pickle.loads(path.read_bytes())
    (tmp_path / "sprung").rmdir()


@pytest.fixture
def yes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user who agrees to whatever a library asks."""
    monkeypatch.setattr("builtins.input", lambda *_: "y")


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Engine], Path]:
    """The folder of each engine's network, which it reads without complaint."""

    @cache
    def make(engine: Engine) -> Path:
        assert engine.good is not None
        folder = engine.good(tmp_path_factory.mktemp("good") / "model")
        engine.call(str(folder))
        return folder

    return make


def weights_of(folder: Path) -> Path:
    (file,) = folder.glob("*.safetensors")
    return file


def nothing_at_all(folder: Path, _: str) -> str:
    shutil.rmtree(folder)
    return r"there are no weights here; give the path of|unet: not the folder of a model, it has no config"


def file_instead(folder: Path, _: str) -> str:
    shutil.rmtree(folder)
    folder.write_text("not a folder")
    return r"not the folder of a model, it has no \w+\.json; give the folder that was fetched"


def empty_folder(folder: Path, _: str) -> str:
    shutil.rmtree(folder)
    folder.mkdir()
    return r"not the folder of a model, it has no \w+\.json; give the folder that was fetched"


def cut_config(folder: Path, _: str) -> str:
    (folder / "config.json").write_text('{"model_type": ')
    return r"config\.json: not JSON, or cut off; fetch the folder again"


def without_weights(folder: Path, _: str) -> str:
    weights_of(folder).unlink()
    return r"cannot be read \(.+\); is it the right folder, and whole\?"


def text_for_weights(folder: Path, _: str) -> str:
    weights_of(folder).write_text("version https://git-lfs.github.com/spec/v1\n")
    return r"cannot be read \(.+\); is it the right folder, and whole\?"


def truncated_weights(folder: Path, _: str) -> str:
    weights_of(folder).write_bytes(weights_of(folder).read_bytes()[:-100])
    return r"cannot be read \(.+\); is it the right folder, and whole\?"


def half_of_the_weights(folder: Path, lost: str) -> str:
    from safetensors.torch import load_file, save_file

    tensors = load_file(weights_of(folder))
    kept = {name: tensor for name, tensor in tensors.items() if lost not in name}
    assert 0 < len(kept) < len(tensors)
    save_file(kept, weights_of(folder), {"format": "pt"})
    return rf"weights of another network \(lacks \S*{lost}\S*\); is it the right folder\?"


def code_for_weights(folder: Path, _: str) -> str:
    from safetensors.torch import load_file

    tensors = load_file(weights_of(folder))
    stem = {"model": "pytorch_model"}.get(weights_of(folder).stem, weights_of(folder).stem)
    weights_of(folder).unlink()
    torch.save(tensors | {"hook": Trap(sprung(folder))}, folder / f"{stem}.bin")
    return r"cannot be read \(.+\); is it the right folder, and whole\?"


def code_beside_weights(folder: Path, _: str) -> str:
    """What the libraries would import if they were told to trust it."""
    classes = ("AutoConfig", "AutoModel", "AutoModelForSemanticSegmentation", "AutoModelForDepthEstimation")
    config = {"model_type": "own", "_class_name": "Own", "auto_map": {name: f"own.{name}" for name in classes}}
    (folder / "config.json").write_text(json.dumps(config))
    (folder / "own.py").write_text(f"import os\n\nos.mkdir({str(sprung(folder))!r})\n")
    return r"holds a model of type own, not|cannot be read \(.*custom code.*\); is it the right folder"


def sprung(folder: Path) -> Path:
    return folder / "sprung"


@each(*FOLDERS)
@case(
    nothing_at_all, file_instead, empty_folder, cut_config, without_weights, text_for_weights, truncated_weights,
    half_of_the_weights, code_for_weights, code_beside_weights,
)  # fmt: skip
@pytest.mark.usefixtures("yes")
def test_folders(
    engine: Engine, spoil: Callable[[Path, str], str], good: Callable[[Engine], Path], tmp_path: Path
) -> None:
    bad = tmp_path / "bad"
    shutil.copytree(good(engine), bad)
    part = bad / engine.part
    message = spoil(part, engine.lost)
    assert_refuses(engine, bad, message)
    assert not sprung(part).exists()


@each(*FOLDERS)
def test_folders_of_another_architecture(engine: Engine, good: Callable[[Engine], Path]) -> None:
    (other,) = (
        one for one in FOLDERS if one.kind is (OneFormerLabeler if engine.kind is AnyLocRetriever else AnyLocRetriever)
    )
    assert_refuses(engine, good(other), r"; (is it the right|give the folder)")
