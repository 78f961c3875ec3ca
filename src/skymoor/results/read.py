# SPDX-License-Identifier: Apache-2.0
"""A finished run, read back from its folder: what reports, viewers, exports and notebooks work with."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from skymoor.engines.libraries import require
from skymoor.engines.regular import arrays_of, is_there, regular
from skymoor.errors import InputError
from skymoor.evaluate import EvaluationRow, evaluate
from skymoor.geo import UNKNOWN_ACCURACY, EnuFrame, checked_covariance
from skymoor.geometry import Similarity
from skymoor.results.geodataframes import Layer, geodataframe
from skymoor.results.tables import CAMERA_COLUMNS, CameraRow, read_camera_rows, read_cameras_csv, read_truth_csv
from skymoor.types import Array, HeightStatus

if TYPE_CHECKING:
    import geopandas
    import pandas as pd
    import pycolmap

RUN_FIRST = "run skymoor run first"
STATISTICS, HEIGHT_DIFFERENCE = "statistics.json", "height_difference"


@dataclass(frozen=True, eq=False, repr=False)
class ComponentSummary:
    """One component of a set of photos; `summary` is its part of summary.json, and the rest is for convenience.

    Attributes:
        image_set, index: which one; its products are called `name`.
        registered, reason: whether it was accepted, and why not.
        heights: CONFIRMED, OFFSET_ONLY or NOT_CONFIRMED; None where it is not registered.
        ce90_m, le90_m: predicted, means over the cameras; None where it is not registered. Without confirmed heights
            there may be no LE90.
    """

    image_set: str
    index: int
    registered: bool
    reason: str
    heights: HeightStatus | None
    ce90_m: float | None
    le90_m: float | None
    summary: dict[str, Any]

    @property
    def name(self) -> str:
        """Such as airborne_0."""
        return f"{self.image_set}_{self.index}"

    def __repr__(self) -> str:
        if not self.registered:
            return f"{self.name}: NOT_REGISTERED, {self.reason}"
        accuracy = "" if self.ce90_m is None else f", CE90 {self.ce90_m:.2f} m"
        accuracy += "" if self.le90_m is None else f", LE90 {self.le90_m:.2f} m"
        heights = f", heights {self.heights}" if self.heights else ""
        return f"{self.name}: REGISTERED, {self.summary.get('n_cameras', '?')} cameras{accuracy}{heights}"

    @cached_property
    def enu_from_sfm(self) -> Similarity | None:
        """ENU metres of the site from the units of the reconstruction; None where it is not registered."""
        transform = self.summary.get("enu_from_sfm")
        if transform is None:
            return None
        return Similarity.from_quaternion_wxyz(
            transform["scale"], transform["quaternion_wxyz"], transform["translation_m"]
        )


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """What `skymoor run` left in `folder`.

    Attributes:
        folder: of the run.
        summary: summary.json, as it is.
        frame: of all ENU positions.
        covariance: of the reference (3, 3), m^2, east-north-up; NaN where its accuracy is unknown.
        components: of all sets, in the order of the summary.
    """

    folder: Path
    summary: dict[str, Any]
    frame: EnuFrame
    covariance: Array
    components: tuple[ComponentSummary, ...]

    @classmethod
    def read(cls, folder: Path | str) -> Result:
        """Read the folder of a finished run. Raises `InputError` when there is none, or it is damaged."""
        path = Path(folder) / "summary.json"
        if not is_there(Path(folder), folder=True):
            raise InputError(f"{folder}: there is no such folder; name the one that skymoor run wrote with --out")
        if not path.exists():
            raise InputError(f"{folder}: is not the folder of a finished run, it has no summary.json; {RUN_FIRST}")
        try:
            summary = json.loads(regular(path).read_text(encoding="utf-8"))
            origin = summary["enu_origin"]
            frame = EnuFrame(float(origin["lat"]), float(origin["lon"]), float(origin["height"]))
            stated = summary["reference"]["covariance_m2"]
            covariance = UNKNOWN_ACCURACY if stated is None else checked_covariance(stated, name="covariance_m2")
            components = tuple(_component(one["set"], part) for one in summary["sets"] for part in one["components"])
        except InputError as error:  # of an origin that is not on Earth, a covariance that is none
            raise InputError(f"{path}: {error}") from error
        except (OSError, ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
            raise InputError(f"{path}: no summary of a finished run ({error}); {RUN_FIRST}") from error
        return cls(Path(folder), summary, frame, covariance, components)

    @property
    def registered(self) -> bool:
        """Whether every set is."""
        return all(one["status"] == "REGISTERED" for one in self.summary["sets"])

    @property
    def heights_confirmed(self) -> bool:
        """Whether the heights of every registered component are."""
        return all(one.heights == "CONFIRMED" for one in self.components if one.registered)

    @cached_property
    def cameras(self) -> tuple[CameraRow, ...]:
        """Every image of the run, as cameras.csv has them. Raises `InputError` when that cannot be read."""
        return tuple(read_camera_rows(self.folder / "cameras.csv"))

    @cached_property
    def registered_cameras(self) -> tuple[CameraRow, ...]:
        """Those with a position."""
        return tuple(row for row in self.cameras if row.lat is not None)

    @cached_property
    def statistics(self) -> dict[str, Any]:
        """Photos, match graph and overlap by the names of components; empty of runs of versions that wrote none."""
        try:
            found = json.loads(regular(self.folder / STATISTICS).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return {}
        if not isinstance(found, dict):
            return {}
        return {name: one for name, one in found.items() if name != HEIGHT_DIFFERENCE}  # which is of all together

    def scene_centres(self) -> dict[tuple[str, int], Array]:
        """Where each registered component's scene is, (3,) ENU metres, by set and number."""
        return {
            (one.image_set, one.index): np.array(one.summary["scene_centre_enu"], dtype=np.float64)
            for one in self.components
            if "scene_centre_enu" in one.summary
        }

    def photo(self, image: str) -> Path:
        """The file of a photo by its name in cameras.csv. Raises `InputError` when it is not where it was."""
        from skymoor.store import FRAMES  # here, since results are read without what makes them

        known = next((row.set for row in self.cameras if row.image == image), None)
        places = [place for one in self.summary["sets"] if one["set"] == known for place in _places(one, image)]
        places.append(self.folder / FRAMES / image)
        path = next((place for place in places if place.is_file()), places[0] if len(places) > 1 else None)
        if path is None or not path.is_file():
            raise InputError(f"{path or image}: the photo is not where the run found it; put it back, or {RUN_FIRST}")
        return path

    def model(self, component: ComponentSummary) -> pycolmap.Reconstruction:
        """The COLMAP model of a component in ENU metres. Raises `InputError` where it has none, or it is damaged."""
        from skymoor.models.colmap import open_colmap  # here, since it loads COLMAP

        folder = self.folder / "colmap" / component.name
        try:
            return open_colmap(folder)
        except InputError as error:
            raise InputError(f"{folder}: no COLMAP model of the run; {RUN_FIRST}") from error

    def residuals(self, component: ComponentSummary) -> Array | None:
        """Residuals of the inliers, (n, 3) metres east, north, up; None if they were not kept."""
        try:
            file = self.folder / "matches" / f"{component.name}.npz"
            residuals, inliers = arrays_of(file, ("residuals_m", "inliers"))
            metres: Array = np.asarray(residuals, np.float64)[inliers]
        except (OSError, ValueError, TypeError, IndexError):  # a former version's, or damaged
            return None
        return metres if len(metres) else None

    def evaluate(self, truth: Path | str) -> list[EvaluationRow]:
        """Errors against truth.csv (`image,lat,lon,height`), metres, one row for each set and component.

        Cameras that the table does not know are counted. Raises `InputError` when it cannot be read, or knows none of
        the registered ones.
        """
        estimates, truths = read_cameras_csv(self.folder / "cameras.csv"), read_truth_csv(Path(truth))
        return evaluate(estimates, truths, self.frame, self.covariance, self.scene_centres())

    def to_dataframe(self) -> pd.DataFrame:
        """cameras.csv as a table of pandas, one row per image. Raises `BackendUnavailable` where pandas is missing."""
        pandas = require("pandas", "table")
        return pandas.DataFrame.from_records([asdict(row) for row in self.cameras], columns=CAMERA_COLUMNS)

    def to_geodataframe(self, layer: Layer = "cameras") -> geopandas.GeoDataFrame:
        """The same with points of WGS 84 longitude, latitude, height (EPSG:4979), none where not registered.

        The other `layer`, "footprints", is the outline on the ground of each photo (EPSG:4326), as `skymoor export`
        writes it. Raises `BackendUnavailable` where geopandas is missing.
        """
        return geodataframe(self, layer)

    def to_crs(self, crs: Any, layer: Layer = "cameras") -> geopandas.GeoDataFrame:
        """`to_geodataframe` in another CRS: "EPSG:32632", or with a vertical datum "EPSG:32632+3855".

        Geometries have the axes of the CRS, x (east, longitude) first: in a two-dimensional one they are points without
        a height, in a compound or 3D one z is in its vertical datum and unit, and NaN where heights are not confirmed.
        Footprints have no heights. The columns lat, lon and height stay WGS 84.

        Args:
            crs: anything that pyproj takes for a CRS.
            layer: "cameras" or "footprints".

        Raises:
            InputError: the CRS is not known, is not defined at the site, or needs a grid that is not installed; one
                line names it. No transformation is replaced by a coarser one that leaves out a shift of the datum.
            BackendUnavailable: geopandas is missing.
        """
        return geodataframe(self, layer, crs)

    def __repr__(self) -> str:
        lines = [f"{self.summary.get('site', '')}: result in {self.folder}"]
        return "\n".join([*lines, *(f"  {one}" for one in self.components)])

    def _repr_html_(self) -> str:
        from skymoor.results.report.notebook import result_html  # here, since it reads results itself

        return result_html(self)


def _places(image_set: dict[str, Any], image: str) -> list[Path]:
    """Where a photo of a set may lie by its name: in one of the folders that the set is made of."""
    if "sources" not in image_set:  # of a former version, which read no sub-folders
        return [Path(image_set["folder"]) / PurePosixPath(image).name] if "folder" in image_set else []
    sources = [(Path(one["path"]), PurePosixPath(one["name"])) for one in image_set["sources"]]
    name = PurePosixPath(image)
    return [folder / name.relative_to(prefix) for folder, prefix in sources if name.is_relative_to(prefix)]


def _component(set_name: str, summary: dict[str, Any]) -> ComponentSummary:
    return ComponentSummary(
        image_set=str(set_name),
        index=int(summary["component"]),
        registered=summary["status"] == "REGISTERED",
        reason=str(summary["reason"]),
        heights=summary.get("heights"),
        ce90_m=summary.get("predicted_ce90_m"),
        le90_m=summary.get("predicted_le90_m"),
        summary=summary,
    )


def read(folder: Path | str) -> Result:
    """Load the folder of a finished run: JSON and CSV only.

    Raises:
        InputError: there is none, or it is damaged.
    """
    return Result.read(Path(folder))
