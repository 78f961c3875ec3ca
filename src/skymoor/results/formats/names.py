# SPDX-License-Identifier: Apache-2.0
"""Names for programs that know photos by their bare file names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import PurePosixPath

from skymoor.errors import InputError


def table_names(images: Iterable[str]) -> dict[str, str]:
    """The same for tables that other programs read without quotation marks.

    Raises `InputError` for a name that would be taken for several cells.
    """
    names = bare_names(images)
    for image, name in names.items():
        if any(letter in name for letter in ',;"\t'):
            raise InputError(
                f"{image}: Metashape and RealityScan part cells by commas; rename the photo without comma, semicolon, "
                "tab and quotation mark, and run again"
            )
    return names


def bare_names(images: Iterable[str]) -> dict[str, str]:
    """The file name of each image; of images of one name in several folders, that of the folder goes before it."""
    ordered = list(images)
    bare = Counter(PurePosixPath(image).name for image in ordered)
    with_folder = Counter("_".join(PurePosixPath(image).parts[-2:]) for image in ordered)
    names = {}
    for image in ordered:
        path = PurePosixPath(image)
        name = path.name if bare[path.name] == 1 else "_".join(path.parts[-2:])
        names[image] = name if bare[path.name] == 1 or with_folder[name] == 1 else "_".join(path.parts)
    return names
