# SPDX-License-Identifier: Apache-2.0
"""Read a finished run: its status, its cameras, and its figures as HTML: read_a_result.py RESULT FOLDER."""

import sys
from pathlib import Path

import skymoor


def main(run: Path, folder: Path) -> None:
    """Figures go to FOLDER."""
    result = skymoor.read(run)  # in a notebook, `result` on a line of its own shows a table
    print("everything is registered" if result.registered else "something is not registered")
    for component in result.components:
        print(component.name, component.reason or f"CE90 {component.ce90_m:.1f} m, LE90 {component.le90_m:.1f} m")
    for row in result.cameras:
        if row.east is not None:
            print(f"{row.image}: {row.lat:.7f}, {row.lon:.7f}, {row.height:.2f} m above the ellipsoid")
    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        "cameras": skymoor.plot_cameras(result),
        "residuals": skymoor.plot_residuals(result),
        "stages": skymoor.plot_stages(result),
    }
    for name, figure in figures.items():
        figure.write_html(folder / f"{name}.html")  # one file that needs no network
        print(folder / f"{name}.html")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
