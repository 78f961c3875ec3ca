# SPDX-License-Identifier: Apache-2.0
"""skymoor moors floating 3D models to the Earth.

For notebooks and scripts: `register` places photos, `read` reads what a run left, and both give a `Result`. Everything
here is imported when it is first asked for, so that `import skymoor` costs nothing.
"""

# pycolmap exports its static zlib symbols; unless the system's zlib is loaded first, a later PNG write
# through another library corrupts the heap. Keep this the first import of the package.
import zlib  # noqa: F401, I001

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skymoor.api import read, register
    from skymoor.errors import BackendUnavailable, InputError, SkymoorError
    from skymoor.result import Result

__all__ = ["BackendUnavailable", "InputError", "Result", "SkymoorError", "__version__", "read", "register"]
__version__ = "0.1.0"

_HOMES = {
    **dict.fromkeys(("BackendUnavailable", "InputError", "SkymoorError"), "skymoor.errors"),
    "Result": "skymoor.result",
    "read": "skymoor.api",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """Keeps the name `skymoor.register` for the function: importing the stage of that name would put its module there.

    The stage is had by `from skymoor.register import ...`, as everywhere in here.
    """

    @property
    def register(self) -> Any:
        return import_module("skymoor.api").register

    @register.setter
    def register(self, module: ModuleType) -> None:
        pass


sys.modules[__name__].__class__ = _Package
