# SPDX-License-Identifier: Apache-2.0
"""The run that pictures are made of, and the same run refused."""

from __future__ import annotations

import os
import pty
import shutil
import signal
import subprocess
import sys
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer

from PIL import Image

from skymoor.results.read import Result

QUALITY = 72
UNREACHABLE = "register.min_score=1000"
"""An option that refuses everything: what the page of `skymoor ask` is about."""
REFUSED_STATUS = 3


class Missing(Exception):
    """A run has not what a picture is made of."""


class Source:
    """A finished run; use it as a context manager."""

    def __init__(self, folder: Path) -> None:
        """Raises `skymoor.errors.InputError` where there is no run."""
        self.folder, self.result = folder, Result.read(folder)
        self._scratch = TemporaryDirectory(prefix="skymoor-gallery-")

    def __enter__(self) -> Source:
        return self

    def __exit__(self, *_: object) -> None:
        self._scratch.cleanup()

    def image(self, name: str) -> Image.Image:
        """A picture of the run by its path. Raises `Missing`."""
        path = self.folder / name
        if not path.is_file():
            raise Missing(f"the run has no {name}")
        return Image.open(path).convert("RGB")

    @property
    def site(self) -> Path:
        """site.toml beside the run. Raises `Missing`."""
        path = self.folder.parent / "site" / "site.toml"
        if not path.is_file():
            raise Missing(f"{path}: there is no site beside the run, as skymoor demo makes it")
        return path

    @property
    def scratch(self) -> Path:
        """A folder that is removed in the end."""
        return Path(self._scratch.name)

    @cached_property
    def refused(self) -> Path:
        """The same site refused by an unreachable limit, from the stages of the run."""
        folder = self.scratch / "refused"
        shutil.copytree(self.folder, folder)
        command = [sys.executable, "-m", "skymoor", "run", str(self.site), "--out", str(folder), "--set", UNREACHABLE]
        status = subprocess.run(command, capture_output=True, check=False).returncode
        if status != REFUSED_STATUS:
            raise RuntimeError(f"{' '.join(command)}: status {status}, and {REFUSED_STATUS} was wanted")
        return folder


def on_terminal(command: list[str], stop_s: float) -> str:
    """What a command wrote to a terminal of 100 columns until it was interrupted."""
    ours, theirs = pty.openpty()
    environment = os.environ | {"COLUMNS": "100", "LINES": "30", "TERM": "xterm-256color"}
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    # Not SIGINT, which a job in the background of a script, and all it starts, is deaf to.
    Timer(stop_s, process.send_signal, [signal.SIGTERM]).start()
    shown = bytearray()
    try:
        while part := os.read(ours, 4096):
            shown.extend(part)
    except OSError:  # as Linux says that the other end was closed
        pass
    os.close(ours)
    process.wait()
    return shown.decode(errors="replace")


def saved(picture: Image.Image, path: Path, width: int) -> None:
    """As JPEG of that width at most."""
    if picture.width > width:
        picture = picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.LANCZOS)
    picture.save(path, quality=QUALITY, optimize=True, progressive=True)
