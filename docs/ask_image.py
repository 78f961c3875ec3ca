# SPDX-License-Identifier: Apache-2.0
"""The picture of the page of `skymoor ask`: python docs/ask_image.py RUN docs/images/ask.jpg

RUN is the folder of a refused run; that of the picture is a simulated site, refused by an unreachable limit:
skymoor simulate --preset office-park --seed 5 --out site; skymoor run site --out RUN --set register.min_score=1000
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from skymoor.results.ask.question import questions_of
from skymoor.results.ask.server import AskServer
from skymoor.results.read import Result

SIZE, WIDTH, QUALITY = "1200,1330", 1000, 82


def main(run: Path, picture: Path, chromium: str = "chromium") -> None:
    """Open the page in a headless Chromium, and keep what it shows."""
    result = Result.read(run)
    with AskServer(result, questions_of(result)) as server, TemporaryDirectory() as folder:
        shot = Path(folder) / "ask.png"
        flags = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=4000")
        flags += (f"--user-data-dir={folder}/profile", f"--window-size={SIZE}", f"--screenshot={shot}")
        subprocess.run([chromium, *flags, server.address], check=True, timeout=120, capture_output=True)
        with Image.open(shot) as image:
            image.convert("RGB").resize((WIDTH, WIDTH * image.height // image.width)).save(picture, quality=QUALITY)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
