# SPDX-License-Identifier: Apache-2.0
"""The QGIS plugin, its modules without QGIS, and QGIS itself where it is installed."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

PLUGIN = Path(__file__).parents[2] / "qgis" / "skymoor_qgis"
SESSION = Path(__file__).with_name("qgis_session.py")
PROCESSING = ("/usr/share/qgis/python/plugins", "/usr/local/share/qgis/python/plugins")


def plugin_module(name: str) -> Any:
    """A module of the plugin that imports nothing of QGIS."""
    spec = importlib.util.spec_from_file_location(f"skymoor_qgis_{name}", PLUGIN / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


def write_command(folder: Path, body: str) -> Path:
    """A shell script that stands for the skymoor command."""
    path = folder / "skymoor"
    path.write_text(f"#!/bin/sh\n{body}\n", encoding="utf-8")
    path.chmod(0o755)
    return path


@cache
def qgis_python() -> str | None:
    """The Python that has QGIS, with its Processing plugin; None where there is none. QGIS_PYTHON may name it."""
    candidates = [os.environ.get("QGIS_PYTHON"), "/usr/bin/python3", shutil.which("python3")]
    for path in filter(None, candidates):
        ask = [path, "-c", "import qgis.core, processing.core"]
        try:
            done = subprocess.run(ask, env=_environment(Path()), capture_output=True, timeout=60, check=False)
        except OSError:
            continue
        if done.returncode == 0:
            return path
    return None


def qgis_session(folder: Path, **job: Any) -> dict[str, Any]:
    """What came of one algorithm in QGIS; see `qgis_session.py`."""
    python = qgis_python()
    assert python is not None
    done = subprocess.run(
        [python, str(SESSION)],
        input=json.dumps(job),
        env=_environment(folder),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stdout, done.stderr[-3000:]
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def _environment(folder: Path) -> dict[str, str]:
    """No window, and a profile of its own."""
    own = {name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "PYTHONPATH", "VIRTUAL_ENV")}
    paths = os.pathsep.join([*PROCESSING, str(PLUGIN.parent)])
    return own | {
        "QT_QPA_PLATFORM": "offscreen",
        "QGIS_CUSTOM_CONFIG_PATH": str(folder / "profile"),
        "XDG_RUNTIME_DIR": str(folder),
        "PYTHONPATH": paths,
    }
