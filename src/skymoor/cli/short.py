# SPDX-License-Identifier: Apache-2.0
"""Arguments that have a short form too, the same in every command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

Out = Annotated[Path, tyro.conf.arg(aliases=["-o"])]
Quiet = Annotated[bool, tyro.conf.arg(aliases=["-q"])]
Verbose = Annotated[bool, tyro.conf.arg(aliases=["-v"])]
