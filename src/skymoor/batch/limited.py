# SPDX-License-Identifier: Apache-2.0
"""`python -m skymoor.batch.limited GIGABYTES ARGUMENTS...`: skymoor with a bound on its memory.

It ends with the process that started it, so that a lost worker leaves none behind that holds a site's folder.
"""

from __future__ import annotations

import ctypes
import runpy
import signal
import sys

PR_SET_PDEATHSIG = 1  # of Linux, prctl(2)


def main() -> None:
    """Bound this process, then be skymoor."""
    gigabytes, sys.argv = float(sys.argv[1]), ["skymoor", *sys.argv[2:]]
    if sys.platform == "linux":
        import resource

        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if gigabytes > 0:
            most = int(gigabytes * 1e9)
            resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    runpy.run_module("skymoor", run_name="__main__")


if __name__ == "__main__":
    main()
