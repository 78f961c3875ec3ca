# SPDX-License-Identifier: Apache-2.0
"""Lay what ODM or WebODM made on a reference: lay_odm_on_reference.py PROJECT REFERENCE.toml OUT.

PROJECT is ODM's project folder, or the all.zip that WebODM offers for download. REFERENCE.toml has the table
[reference] of a site.toml, as `skymoor reference` writes it, with the accuracy filled in. OUT/project gets the moved
files in ODM's layout.
"""

import shutil
import sys
import tomllib
from pathlib import Path
from typing import Any

import skymoor


def main(project: Path, reference: Path, out: Path, **more: Any) -> bool:
    """Whether the project was registered; its moved files are then in OUT/project."""
    if project.suffix == ".zip":
        shutil.unpack_archive(project, out / "unpacked")
        project = out / "unpacked"
    stated = tomllib.loads(reference.read_text(encoding="utf-8"))["reference"]
    for name in ("ortho", "dsm"):
        if isinstance(stated.get(name), str):
            stated[name] = reference.parent / stated[name]
    known = ("ortho", "dsm", "vertical_datum", "ce90", "le90", "accuracy")
    arguments = {key: value for key, value in stated.items() if key in known}
    result = skymoor.register_model(project, out=out / "result", **arguments, **more)
    print(result)
    if not result.registered:
        return False
    for path in sorted(project.rglob("*")):
        moved = out / "result" / "placed" / path.with_suffix(".laz" if path.suffix == ".las" else path.suffix).name
        if path.is_file() and moved.is_file():
            target = out / "project" / path.relative_to(project).parent / moved.name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(moved, target)
            print(f"{target}: moved")
    return True


if __name__ == "__main__":
    sys.exit(0 if main(*map(Path, sys.argv[1:4])) else 3)
