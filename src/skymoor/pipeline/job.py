# SPDX-License-Identifier: Apache-2.0
"""Input of the pipeline for a set of photos, and its results for each component."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from skymoor.control import ControlResult
from skymoor.densify import MetricScale, PoseCheck
from skymoor.errors import BackendUnavailable, InputError
from skymoor.geometry import Similarity
from skymoor.ground.walls import GroundPoseCheck
from skymoor.match import ImageHypothesis
from skymoor.match.features import Features
from skymoor.model import SceneModel
from skymoor.pipeline.options import Options
from skymoor.pipeline.prior import Heading
from skymoor.pipeline.search import MapFiles
from skymoor.pipeline.stopping import StopAfter, StoppedAfter
from skymoor.registration import NullSample
from skymoor.store import Store
from skymoor.types import (
    Array,
    Camera,
    Component,
    DepthMap,
    Gravity,
    HeightVerdict,
    Image,
    Mask,
    Matches3D,
    Photos,
    Progress,
    Reference,
    Registration,
    Render,
)

T = TypeVar("T")
NEAREST = 4

LOG = logging.getLogger("skymoor")


@dataclass(frozen=True, eq=False)
class Job:
    """What one set of photos is registered with.

    `track` gives the progress callback of a stage, by its name; `features` those of the reference, found when they are
    first asked for; `files` are orthophoto, DSM and vertical datum that it was read from, and `heading` what somebody
    knows of the photos' directions. `stop_after` is the last step to do; None for all.
    """

    photos: Photos
    reference: Reference
    options: Options
    store: Store
    seed: int
    track: Callable[[str], Progress]
    name: str = "airborne"
    files: MapFiles | None = None
    heading: Heading | None = None
    features: Callable[[], Features] = Features.none
    stop_after: StopAfter | None = None

    def end_of(self, step: StopAfter) -> None:
        """Raise `StoppedAfter` where this was the last step to do: for its component, which `or_else` then leaves."""
        if step == self.stop_after:
            raise StoppedAfter(step)


@dataclass(frozen=True)
class MapHypothesis:
    """One hypothesis of a component on the map, accepted or not.

    Attributes:
        score: of the search; comparable among hypotheses of one component.
        east, north: of the centre of the airborne render, or of the ground cameras, ENU metres.
        azimuth_deg: rotation from the level frame, clockwise seen from above, 0 to 360.
        metres_per_unit: of the level frame.
    """

    score: float
    east: float
    north: float
    azimuth_deg: float
    metres_per_unit: float


@dataclass(frozen=True, eq=False)
class Searched:
    """Hypotheses of a component in the reference, best first, and what decoys of its render reach there."""

    hypotheses: Sequence[ImageHypothesis]
    decoys: Sequence[NullSample]


@dataclass(frozen=True, eq=False)
class ComponentResult:
    """A component and the results of its registration. `component` is in the `level` frame.

    `name` is that of its stages. `pose_checks` compare each photo with the others. A ground
    component is registered to `base`, an airborne one, and `walls` shows both; or straight to the reference, and `plan`
    shows it there; `metric` is its scale by monocular depth.
    `hypotheses` are all that were found, the best first, and `searched` the same in pixels. `flat` says that its
    heights are no measurement, but those of a plane: it is an orthophoto alone. `control` is what surveyed points and
    positions say of it.
    """

    name: str
    component: Component
    level_from_sfm: Similarity
    registration: Registration
    gravity: Gravity | None = None
    depths: Sequence[DepthMap] = ()
    model: SceneModel | None = None
    render: Render | None = None
    matches: Matches3D | None = None
    base: ComponentResult | None = None
    walls: Image | None = None
    plan: Image | None = None
    pose_checks: Sequence[GroundPoseCheck | PoseCheck] = ()
    metric: MetricScale | None = None
    hypotheses: Sequence[MapHypothesis] = ()
    searched: Searched | None = None
    flat: bool = False
    control: ControlResult | None = None

    @property
    def cameras_enu(self) -> list[Camera]:
        """Cameras on Earth; empty where the component is not registered, and without those that contradict it."""
        found = self.registration
        if not found.registered or found.enu_from_level is None:
            return []
        trusted = zip(self.component.cameras, self._trusted, strict=True)
        return [camera.transformed(found.enu_from_level) for camera, is_trusted in trusted if is_trusted]

    @property
    def heights(self) -> HeightVerdict | None:
        """The verdict on heights: a ground component shares that of the airborne one that it is registered to."""
        return self.registration.heights if self.base is None else self.base.heights

    @property
    def scaled_by_focal_length(self) -> bool:
        """Whether its cameras are as far from what they show as their focal length says.

        A model that is registered to another, or by its plan, takes its scale from that.
        """
        return self.base is None and self.plan is None

    @property
    def shape_enu(self) -> Array | None:
        """Covariances (n, 3, 3) m^2 of the centres of `cameras_enu` by the reconstruction alone; None if not known."""
        enu_from_level = self.registration.enu_from_level
        if enu_from_level is None or self.component.centre_covariances is None:
            return None
        turn = enu_from_level.scale * enu_from_level.rotation
        return np.asarray(turn @ self.component.centre_covariances[self._trusted] @ turn.T)

    @property
    def viewed_enu(self) -> Array | None:
        """Where a camera of each of `cameras_enu` looks (n, 3), ENU metres; None if not registered.

        Along the mean axis of a camera and its nearest ones: the jitter of a single nadir photo moves it aside no more
        than its neighbours, which share its points.
        """
        enu_from_level, seen = self.registration.enu_from_level, self.component
        if enu_from_level is None:
            return None
        centres, axes = seen.centres, np.array([camera.cam_from_world.rotation[2] for camera in seen.cameras])
        viewed = []
        for k in np.flatnonzero(self._trusted):
            points = seen.points[seen.obs_point[seen.obs_camera == k]]
            near = np.argsort(np.linalg.norm(centres - centres[k], axis=1), kind="stable")[: NEAREST + 1]
            axis = axes[near].mean(axis=0) / np.linalg.norm(axes[near].mean(axis=0))
            depth = np.median((points if len(points) else seen.points) @ axis) - centres[k] @ axis
            viewed.append(centres[k] + depth * axis)
        return enu_from_level.apply(np.array(viewed).reshape(-1, 3))

    @property
    def component_enu(self) -> Component | None:
        """The component on Earth without cameras that contradict it and what they see; None if it is not registered."""
        enu_from_level = self.registration.enu_from_level
        if not self.registration.registered or enu_from_level is None:
            return None
        return self.component.of_cameras(self._trusted).transformed(enu_from_level)

    @property
    def _trusted(self) -> Mask:
        doubted = {check.image for check in self.pose_checks if check.contradicts}
        return np.array([camera.image not in doubted for camera in self.component.cameras], bool)


def refused(name: str, component: Component, reason: str) -> ComponentResult:
    """A component that was refused, with the reason."""
    nothing = Registration(registered=False, reason=reason, enu_from_level=None)
    return ComponentResult(name, component, Similarity.identity(), nothing)


def or_else(action: Callable[[], T], otherwise: Callable[[str], T], what: str) -> T:
    """The result of `action`; where it fails unexpectedly, that of `otherwise`, which is given the reason.

    An error in one component must not cost the results of the others: it is logged with its traceback. What ends the
    run all the same are wrong input, a missing engine, a full disk or memory, and the user's interrupt. A component
    that stops after the step that was asked for is left there, so that the others come to the same step.

    Args:
        action: the work.
        otherwise: makes a refusal of the reason.
        what: the name of the component or set, for the log.
    """
    try:
        return action()
    except StoppedAfter as stop:
        return otherwise(str(stop))
    except (InputError, BackendUnavailable, OSError, MemoryError):
        raise
    except Exception as error:
        LOG.exception("%s: failed unexpectedly", what)
        return otherwise(f"internal error ({type(error).__name__}: {error}); run.log has the traceback")
