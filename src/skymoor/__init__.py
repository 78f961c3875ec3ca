# SPDX-License-Identifier: Apache-2.0
"""skymoor moors floating 3D models to the Earth.

For notebooks and scripts: `register` places photos, `read` reads what a run left, and both give a `Result`. Everything
here is imported when it is first asked for, so that `import skymoor` costs nothing.
"""

# pycolmap exports its static zlib symbols; unless the system's zlib is loaded first, a later PNG write
# through another library corrupts the heap. Keep this the first import of the package.
import zlib  # noqa: F401, I001

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skymoor.api import read, register
    from skymoor.errors import BackendUnavailable, InputError, SkymoorError
    from skymoor.results.read import Result
    from skymoor.results.report.plots import plot_cameras, plot_residuals, plot_stages

__all__ = [
    "BackendUnavailable",
    "InputError",
    "Result",
    "SkymoorError",
    "__version__",
    "plot_cameras",
    "plot_residuals",
    "plot_stages",
    "read",
    "register",
]
__version__ = "0.1.0"

_HOMES = {
    **dict.fromkeys(("BackendUnavailable", "InputError", "SkymoorError"), "skymoor.errors"),
    "Result": "skymoor.results.read",
    **dict.fromkeys(("read", "register"), "skymoor.api"),
    **dict.fromkeys(("plot_cameras", "plot_residuals", "plot_stages"), "skymoor.results.report.plots"),
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
