# SPDX-License-Identifier: Apache-2.0
"""The products in a run directory: files and folders that are whole or not there."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from skymoor.store._atomic import atomic_file, atomic_folder, disk_errors
from skymoor.store._plain import plain


class Products:
    """Files below a folder, by their names relative to it."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def path(self, *parts: str) -> Path:
        """Where a product lies. Raises `ValueError` for a path outside of the run directory."""
        path = self.root.joinpath(*parts)
        if not Path(os.path.normpath(path)).is_relative_to(self.root):
            raise ValueError(f"{path} is outside of {self.root}")
        return path

    def write_bytes(self, name: str, content: bytes) -> Path:
        """Write a file whole; `name` is relative to the run directory and may hold folders."""
        target = self.path(name)
        with atomic_file(target) as file:
            file.write(content)
        return target

    def write_text(self, name: str, text: str) -> Path:
        """Write UTF-8 text."""
        return self.write_bytes(name, text.encode())

    def write_json(self, name: str, value: object) -> Path:
        """Write JSON; dataclasses become objects, arrays lists, paths text, and numbers that are not finite null."""
        return self.write_text(name, json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n")

    def write_csv(self, name: str, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> Path:
        """Write a table with a header; None becomes an empty cell and floats keep all their digits."""
        buffer = io.StringIO(newline="")
        writer = csv.DictWriter(buffer, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return self.write_text(name, buffer.getvalue())

    def write_png(self, name: str, rgb: NDArray[np.uint8]) -> Path:
        """Write an image (h, w, 3) RGB, (h, w, 4) RGBA or (h, w) grey."""
        buffer = io.BytesIO()
        # A third of the time of the default level, for files that are a tenth larger.
        Image.fromarray(np.ascontiguousarray(rgb, dtype=np.uint8)).save(buffer, format="png", compress_level=3)
        return self.write_bytes(name, buffer.getvalue())

    def write_npz(self, name: str, **arrays: NDArray[Any]) -> Path:
        """Write named arrays, compressed."""
        if any(array.dtype.hasobject for array in arrays.values()):
            raise TypeError("arrays of objects are not written")
        target = self.path(name)
        with atomic_file(target) as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # newer numpy takes a flag by name
        return target

    def write_folder(self, name: str, fill: Callable[[Path], object]) -> Path:
        """Let `fill` write a folder of files, which then replaces the one of that name as a whole."""
        target = self.path(name)
        atomic_folder(target, fill)
        return target

    def remove(self, name: str) -> None:
        """Delete a product of an earlier run, file or folder, if there is one."""
        target = self.path(name)
        with disk_errors(target):
            if target.is_dir() and not target.is_symlink():
                shutil.rmtree(target)
            else:
                target.unlink(missing_ok=True)
