# SPDX-License-Identifier: Apache-2.0
"""skymoor georegisters 3D models from photos without metadata.

For notebooks and scripts: `register` is the whole job, `register_model` the same for a model that exists already,
`read` loads what a run wrote, and all return a `Result`. The single steps are functions, too: `read_reference`,
`render_orthophoto`, `nadir_raster`, `reference_raster`, `match_rasters`, `lift`, `register_matches`, `level_component`,
`render_nadir`. All of them are imported when they are first used, so that `import skymoor` costs nothing.
"""

# pycolmap exports its static zlib symbols; unless the system's zlib is loaded first, a later PNG write
# through another library corrupts the heap. Keep this the first import of the package.
import zlib  # noqa: F401, I001

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skymoor.api import register
    from skymoor.api_models import register_model, render_orthophoto
    from skymoor.api_steps import RasterMatch, level_component, match_rasters
    from skymoor.errors import BackendUnavailable, InputError, SkymoorError
    from skymoor.match.rasters import nadir_raster, reference_raster
    from skymoor.model.views import render_nadir
    from skymoor.pipeline.stopping import StoppedAfter
    from skymoor.reference.read import read_reference
    from skymoor.registration import lift
    from skymoor.registration import register as register_matches
    from skymoor.results.read import Result, read
    from skymoor.results.report.plots import plot_cameras, plot_residuals, plot_stages
    from skymoor.sources.fetch import fetch_reference

__version__ = "0.1.0"

_HOMES = {
    "BackendUnavailable": "errors",
    "InputError": "errors",
    "RasterMatch": "api_steps",
    "Result": "results.read",
    "SkymoorError": "errors",
    "StoppedAfter": "pipeline.stopping",
    "fetch_reference": "sources.fetch",
    "level_component": "api_steps",
    "lift": "registration.lift",
    "match_rasters": "api_steps",
    "nadir_raster": "match.rasters",
    "plot_cameras": "results.report.plots",
    "plot_residuals": "results.report.plots",
    "plot_stages": "results.report.plots",
    "read": "results.read",
    "read_reference": "reference.read",
    "reference_raster": "match.rasters",
    "register": "api",
    "register_matches": "registration.airborne:register",
    "register_model": "api_models",
    "render_nadir": "model.views",
    "render_orthophoto": "api_models",
}
"""Where each public name is defined, and what it is called there if that differs."""

__all__ = [
    "BackendUnavailable",
    "InputError",
    "RasterMatch",
    "Result",
    "SkymoorError",
    "StoppedAfter",
    "__version__",
    "fetch_reference",
    "level_component",
    "lift",
    "match_rasters",
    "nadir_raster",
    "plot_cameras",
    "plot_residuals",
    "plot_stages",
    "read",
    "read_reference",
    "reference_raster",
    "register",
    "register_matches",
    "register_model",
    "render_nadir",
    "render_orthophoto",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, other = _HOMES[name].partition(":")
    return getattr(import_module(f"skymoor.{module}"), other or name)


def __dir__() -> list[str]:
    return list(__all__)
