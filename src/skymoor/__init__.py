# SPDX-License-Identifier: Apache-2.0
"""skymoor moors floating 3D models to the Earth."""

# pycolmap exports its static zlib symbols; unless the system's zlib is loaded first, a later PNG write
# through another library corrupts the heap. Keep this the first import of the package.
import zlib  # noqa: F401

__version__ = "0.1.0"
