# SPDX-License-Identifier: Apache-2.0
"""Registration of two point clouds from an approximate start (paper, section 3.4, the last step).

Point-to-plane ICP (Chen and Medioni 1992) with Tukey's loss, by Open3D. It converges to the nearest
minimum, right or wrong: the start is kept unless the clouds determine all parameters, fit better afterwards, and have
not moved far.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from skymoor.engines.raycast import open3d
from skymoor.errors import TooFewMatches
from skymoor.geometry import Similarity
from skymoor.types import Array


@dataclass(frozen=True)
class IcpOptions:
    """Limits of ICP, and when its result is used.

    Attributes:
        voxel_m: both clouds are thinned to one point per voxel of this size.
        reach_m: a point farther than this from the other cloud has no partner: the clouds overlap in part.
        tukey_m: distances from the partner's plane beyond this do not count.
        max_move_m: a result that moves the points farther than this on average is not used.
        min_gain: share by which the gap between the clouds must shrink. ICP is limited by the accuracy of the surfaces,
            and an airborne model has errors of about half a pixel: on a simulated site of 0.3 m pixels it left 0.2 to
            0.6 m of error from every start, with gains below this where the start was better than that.
        iterations: of Open3D.
        with_scale: whether the scale is free. Then so many `scale_rounds` follow, each all seven parameters at once.
        min_partners: points with a partner.
        min_hold: how well the planes determine the least certain parameter; 1/3 for the three directions of a cube.
    """

    voxel_m: float = 0.2
    reach_m: float = 1.0
    tukey_m: float = 0.3
    max_move_m: float = 1.5
    min_gain: float = 0.12
    iterations: int = 50
    with_scale: bool = False
    scale_rounds: int = 6
    min_partners: int = 100
    min_hold: float = 0.004


@dataclass(frozen=True, eq=False)
class IcpResult:
    """Result of ICP. `target_from_source` is the start where ICP did not help, for `reason`; else that is empty.

    `gap_before_m` and `gap_after_m` are the root mean square distances to the other cloud's planes, none counted for
    more than `tukey_m`; `moved_m` is the mean distance that ICP would have moved the points; `overlap` the share of
    the points that have a partner at the start.
    """

    target_from_source: Similarity
    reason: str
    gap_before_m: float
    gap_after_m: float
    moved_m: float
    overlap: float

    @property
    def helped(self) -> bool:
        """Whether the transform is better than the start."""
        return not self.reason


def refine_icp(source: Array, target: Array, start: Similarity, options: IcpOptions | None = None) -> IcpResult:
    """Register the cloud `source` (n, 3) to `target` (m, 3), in metres, from an approximate `start`.

    Raises `TooFewMatches` when either cloud has less than `min_partners` points, `BackendUnavailable` without Open3D.
    """
    options = options or IcpOptions()
    for name, cloud in (("source", source), ("target", target)):
        if len(cloud) < options.min_partners:
            raise TooFewMatches(f"the {name} has {len(cloud)} points, ICP needs at least {options.min_partners}")
    pair = _Pair.thinned(start.apply(source), target, options)
    gap, overlap = pair.gap_m(Similarity.identity()), pair.overlap()
    if overlap * len(pair.source) < options.min_partners:
        return IcpResult(start, f"only {overlap:.0%} of the points have a partner", gap, gap, 0.0, overlap)
    if pair.hold(Similarity.identity(), with_scale=False) < options.min_hold:
        return IcpResult(start, "the surfaces do not determine a direction", gap, gap, 0.0, overlap)
    step = pair.rigid()
    if options.with_scale:
        step = pair.scaled(step)
    after = pair.gap_m(step)
    moved = float(np.linalg.norm(step.apply(pair.source) - pair.source, axis=1).mean())
    if moved > options.max_move_m:
        reason = f"the points would move by {moved:.2f} m; at most {options.max_move_m:.2f} m is allowed"
    elif after > (1 - options.min_gain) * gap:
        reason = (
            f"the clouds would be closer by only {max(1 - after / gap, 0):.0%}, {options.min_gain:.0%} are required"
        )
    else:
        return IcpResult(step @ start, "", gap, after, moved, overlap)
    return IcpResult(start, reason, gap, after, moved, overlap)


@dataclass(frozen=True, eq=False)
class _Pair:
    """Thinned clouds in the target frame; the target with normals and a tree."""

    source: Array
    target: Any  # Open3D's point cloud
    points: Array
    normals: Array
    tree: cKDTree
    options: IcpOptions

    @classmethod
    def thinned(cls, source: Array, target: Array, options: IcpOptions) -> _Pair:
        o3d = open3d()
        # Normals are estimated near the source only: the target may be a whole site.
        margin = options.reach_m + options.max_move_m + 4 * options.voxel_m
        near = ((target >= source.min(axis=0) - margin) & (target <= source.max(axis=0) + margin)).all(axis=1)
        target = target[near] if np.count_nonzero(near) >= options.min_partners else target
        thin = [_cloud(xyz).voxel_down_sample(options.voxel_m) for xyz in (source, target)]
        search = o3d.geometry.KDTreeSearchParamHybrid(radius=4 * options.voxel_m, max_nn=30)
        thin[1].estimate_normals(search)
        points = np.asarray(thin[1].points)
        return cls(np.asarray(thin[0].points), thin[1], points, np.asarray(thin[1].normals), cKDTree(points), options)

    def partners(self, step: Similarity) -> tuple[Array, Array, Array]:
        """Transformed points (k, 3) that have a partner, its normals (k, 3), and the distances (k,) to its plane."""
        moved = step.apply(self.source)
        distance, index = self.tree.query(moved, distance_upper_bound=self.options.reach_m)
        near = np.isfinite(distance)
        normals = self.normals[index[near]]
        gaps = np.einsum("ij,ij->i", normals, self.points[index[near]] - moved[near])
        return moved[near], normals, gaps

    def overlap(self) -> float:
        return len(self.partners(Similarity.identity())[0]) / len(self.source)

    def gap_m(self, step: Similarity) -> float:
        """RMS over all points: those without a partner count as `tukey_m`, or moving away would reduce it."""
        cut = self.options.tukey_m
        _, _, gaps = self.partners(step)
        lost = len(self.source) - len(gaps)
        return float(np.sqrt((np.minimum(gaps**2, cut**2).sum() + lost * cut**2) / len(self.source)))

    def hold(self, step: Similarity, *, with_scale: bool) -> float:
        """Smallest eigenvalue of the normal equations per unit of weight, lengths in radii of the cloud."""
        normal, _, _ = self._equations(step, with_scale=with_scale)
        return float(np.linalg.eigvalsh(normal)[0])

    def rigid(self) -> Similarity:
        """Rigid ICP by Open3D."""
        icp = open3d().pipelines.registration
        found = icp.registration_icp(
            _cloud(self.source),
            self.target,
            self.options.reach_m,
            np.eye(4),
            icp.TransformationEstimationPointToPlane(icp.TukeyLoss(self.options.tukey_m)),
            icp.ICPConvergenceCriteria(max_iteration=self.options.iterations),
        )
        matrix = np.asarray(found.transformation)
        # Open3D multiplies many small rotations: the product is one up to rounding.
        return Similarity(1.0, Rotation.from_matrix(matrix[:3, :3]).as_matrix(), matrix[:3, 3])

    def scaled(self, step: Similarity) -> Similarity:
        """Gauss-Newton on all seven parameters, which Open3D does not have; the same step for an undetermined scale."""
        for _ in range(self.options.scale_rounds):
            if self.hold(step, with_scale=True) < self.options.min_hold:
                return step
            normal, right, (centre, radius) = self._equations(step, with_scale=True)
            x = np.linalg.solve(normal, right)
            scale, rotation = float(np.exp(x[6] / radius)), Rotation.from_rotvec(x[3:6] / radius).as_matrix()
            step = Similarity(scale, rotation, x[:3] + centre - scale * rotation @ centre) @ step
        return step

    def _equations(self, step: Similarity, *, with_scale: bool) -> tuple[Array, Array, tuple[Array, float]]:
        """Normal matrix and right side for translation, rotation and scale about the centre; centre and radius."""
        moved, normals, gaps = self.partners(step)
        size = 7 if with_scale else 6
        weights = np.maximum(1 - (gaps / self.options.tukey_m) ** 2, 0) ** 2
        if weights.sum() < 1:
            return np.zeros((size, size)), np.zeros(size), (np.zeros(3), 1.0)
        centre = np.average(moved, axis=0, weights=weights)
        arms = moved - centre
        radius = float(np.sqrt(np.average((arms**2).sum(axis=1), weights=weights)))
        columns = [normals, np.cross(arms, normals) / radius]
        if with_scale:
            columns.append(np.einsum("ij,ij->i", arms, normals)[:, None] / radius)
        jacobian = np.hstack(columns)
        weighted = jacobian * (weights / weights.sum())[:, None]
        return weighted.T @ jacobian, weighted.T @ gaps, (centre, radius)


def _cloud(xyz: Array) -> Any:
    o3d = open3d()
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(xyz, dtype=np.float64)))
