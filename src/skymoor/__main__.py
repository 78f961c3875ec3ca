# SPDX-License-Identifier: Apache-2.0
"""`python -m skymoor` is the command `skymoor`."""

import sys

from skymoor.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
