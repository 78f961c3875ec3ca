# SPDX-License-Identifier: Apache-2.0
"""What is no file is not read, and damaged arrays are one kind of error."""

from __future__ import annotations

import os
import struct
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rasterio.errors import RasterioIOError

from skymoor.batch.sites import SiteTask, outcome_of
from skymoor.engines.regular import arrays_of, content_told, is_there, regular
from skymoor.errors import BackendUnavailable, InputError
from skymoor.pipeline.control_files import read_control
from skymoor.pipeline.control_places import Stated
from skymoor.pipeline.reference_files import earlier_run
from skymoor.pipeline.site import load_site
from skymoor.results.read import Result
from skymoor.results.tables import read_truth_csv

DEVICE = Path("/dev/null")  # as endless as /dev/zero for those who do not look, and no danger to this test


def test_links_lead_to_files(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("a")
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "loop").symlink_to("loop")
    assert regular(tmp_path / "link").read_text() == "a"
    for name, kind in (("none", FileNotFoundError), (".", IsADirectoryError), ("loop", OSError)):
        with pytest.raises(kind):
            regular(tmp_path / name)
    assert is_there(tmp_path / "link") and is_there(tmp_path, folder=True)
    assert not any(map(is_there, (tmp_path / "loop", tmp_path / ("x" * 5000), tmp_path / "a\0b")))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such files")
@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("site.toml", load_site),
        ("truth.csv", read_truth_csv),
        ("points.csv", lambda path: read_control([path], Stated())),
        ("summary.json", lambda path: Result.read(path.parent)),
        ("summary.json", lambda path: earlier_run(path.parent)),
    ],
)
def test_pipes_and_devices_are_told(name: str, read: Callable[[Path], object], tmp_path: Path) -> None:
    (tmp_path / name).symlink_to(DEVICE)
    with pytest.raises(InputError, match="pipe or device"):
        read(tmp_path / name)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such files")
def test_a_batch_goes_on_after_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "summary.json")
    found = outcome_of(SiteTask("a", tmp_path / "site.toml", tmp_path), tmp_path, 0, 1.0, "", "")
    assert found.verdict == "FAILED" and "pipe or device" in found.message


def npy(header: str) -> bytes:
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header) + 1) + header.encode() + b"\n"


@pytest.mark.parametrize(
    "header",
    [
        "(" * 500,  # which Python's tokenizer refuses in an error of its own
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
        "{}",
    ],
)
def test_arrays_with_impossible_headers(header: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        file.writestr("x.npy", npy(header))
    with pytest.raises(ValueError, match=r"\w"):
        arrays_of(tmp_path / "a.npz", ["x"])


def test_arrays_that_are_damaged_or_not_there(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, x=np.arange(1000.0))
    np.testing.assert_array_equal(arrays_of(path, ["x"])[0], np.arange(1000.0))
    whole = path.read_bytes()
    for wrong in (b"", whole[:100], whole[:60] + bytes(20) + whole[80:], b"PK" + whole[2:50]):
        path.write_bytes(wrong)
        with pytest.raises(ValueError, match=r"\w"):
            arrays_of(path, ["x"])
    path.write_bytes(whole)
    with pytest.raises(ValueError, match="KeyError"):
        arrays_of(path, ["y"])


class PanicException(BaseException):
    """As libraries in Rust raise it."""


def told(error: BaseException, *, disk: bool = False) -> str:
    """What is told of an error."""
    with pytest.raises(InputError) as caught, content_told(Path("a"), "is odd", "mend it", disk=disk):
        raise error
    return str(caught.value)


def test_what_parsers_raise_is_of_the_content() -> None:
    for error in (ValueError(), RecursionError(), MemoryError(), RasterioIOError("no raster"), PanicException("no")):
        assert told(error).startswith("a: is odd (") and told(error).endswith("); mend it")
    for error in (OSError(28, "No space left on device"), PermissionError(), KeyboardInterrupt(), SystemExit()):
        with pytest.raises(type(error)), content_told(Path("a"), "is odd", "mend it"):
            raise error
    assert told(PermissionError("no"), disk=True) == "a: is odd (no); mend it"
    for error in (KeyboardInterrupt("stop"), InputError("b: is even"), BackendUnavailable("no library")):
        with pytest.raises(type(error), match=str(error)), content_told(Path("a"), "is odd", "mend it", disk=True):
            raise error
    assert told(ValueError("\n first\nsecond")) == "a: is odd ( first); mend it"
    assert told(MemoryError()) == "a: is odd (MemoryError); mend it"
    assert len(told(ValueError("x" * 9999))) < 1000 and len(str(InputError("x" * 9999))) < 2100
    whole = InputError("file.csv: " + "x" * 9999 + "; remove it")
    assert str(whole).startswith("file.csv: ") and str(whole).endswith("; remove it")


def test_a_member_that_is_no_array(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        file.writestr("x", b"text")
    with pytest.raises(ValueError, match="no array"):
        arrays_of(tmp_path / "a.npz", ["x"])
