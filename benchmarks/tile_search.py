# SPDX-License-Identifier: Apache-2.0
"""Tile search on simulated sites: what it finds, what it refuses, and what that costs, for all pairs and for few.

    python benchmarks/tile_search.py RUN [RUN ...] [--results FILE] [--seeds 0 1 2] [--tiles 729]

RUN is a folder as paper_tables.py makes it: a simulated site in RUN/site and its finished run in RUN/result, from whose
cache the ground depth maps and the airborne model are taken. No learned matcher comes with skymoor, so an oracle stands
in its place that knows what every pixel shows, and errs: see `TileOracle`. With several RUNs each component is also
looked for on the next RUN's airborne model, where it is not: both searches have to refuse it.

Seconds are of the processor, all threads together; a learned matcher's would come on top, for each pair.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from paper_tables import print_table, provenance
from scipy.spatial.transform import Rotation

from skymoor.geometry import Similarity, umeyama
from skymoor.ground.tiles import cascade, exhaustive
from skymoor.ground.tiles.images import AirborneTiles, Tile, airborne_tiles, shown_shares
from skymoor.model import RenderOptions, nadir_view, oblique_views, tiles
from skymoor.simulate.light.scene import Scene
from skymoor.simulate.options import SiteOptions
from skymoor.simulate.plan import dates_of, place_of
from skymoor.simulate.site import Site
from skymoor.simulate.world import World
from skymoor.store import read_stage
from skymoor.types import Array, Array32, Camera, DepthMap, Raster, Registration, Render, View, Warp

Mask = NDArray[np.bool_]

MIN_MAPS = 3
WRONG_M = 2.0  # a registration that is farther off than this, in the median over its cameras, is a wrong one
PATCH_PX = 32  # of a photo, in which outliers keep together: single pixels would not find their way back
SMOOTH_PX = 32  # of a tile, over which its error changes: one that changed from pixel to pixel would not survive either
MIN_FALSE, MAX_FALSE = 400, 1600  # pixels that tell a falsehood; a third of them have depth
HEADINGS = (
    *("site", "component", "on", "cameras", "photos", "tiles", "search", "seed", "pairs", "per photo", "of all", "s"),
    *("of all", "oracle's s", "status", "own m", "on the model m", "relative m", "score, next", "reason"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--results", type=Path, help="a JSON file for the rows, with machine, date and commit")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="of the cascade; exhaustive takes the first")
    parser.add_argument("--tiles", type=int, help="render so finely that there are about so many")
    parser.add_argument("--noise-px", type=float, default=1.5, help="of the oracle's right answers, pixels of a tile")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    own = first = Airborne.of(options.runs[0], options.tiles)
    for k, run in enumerate(options.runs):
        other = Airborne.of(options.runs[k + 1], options.tiles) if k + 1 < len(options.runs) else first
        for ground in ground_components(run):
            for airborne in (own, other) if other.site != own.site else (own,):
                for row in searched(ground, airborne, options.seeds, options.noise_px):
                    print(json.dumps(row), flush=True)
                    rows.append(row)
        own = other
    show(rows)
    if options.results:
        settings = {"seeds": options.seeds, "tiles_wanted": options.tiles, "noise_px": options.noise_px}
        about = {**provenance(truth_of(options.runs[0])["options"]["photo_width"]), **settings}
        options.results.write_text(json.dumps({**about, "rows": rows}, indent=1) + "\n")


@dataclass(frozen=True, eq=False)
class Airborne:
    """The renders of a site's airborne model, where the run has placed them, and where they are in truth."""

    site: str
    renders: tuple[Render, ...]
    enu_from_render: Similarity
    true_from_render: Similarity

    @classmethod
    def of(cls, run: Path, n_tiles: int | None) -> Airborne:
        """Render a run's model from above and from eight sides. All is in the frame of the simulated site's truth."""
        # A run that corrected the focal length has placed the model a second time.
        refocused = stage(run, "airborne-0-refocused.register", needed=False)
        name = "airborne-0-refocused" if refocused and refocused[0].registered else "airborne-0"
        model, (registration, _) = (stage(run, f"{name}.{part}") for part in ("model", "register"))
        if registration.enu_from_level is None:
            raise SystemExit(f"{run}: its airborne model is not registered; nothing can be laid on it")
        site, frame = site_of(run), stage(run, "reference").frame
        corners = 100.0 * np.vstack([np.zeros(3), np.eye(3)])
        lat, lon, height = frame.lla_from_enu(corners).T
        site_from_enu = umeyama(corners, site.frame.enu_from_lla(lat, lon, height))
        views = views_of(model.surface_points, model.pixel, n_tiles)
        renders = tuple(model.render(view, progress=lambda *_: None) for view in views)
        truth = laid([m.camera for m in model.maps], site.cameras)
        return cls(run.name, renders, site_from_enu @ registration.enu_from_level, truth)

    @property
    def placed_from_true(self) -> Similarity:
        """Where on Earth something appears that stands rightly on this model."""
        return self.enu_from_render @ self.true_from_render.inverse()


@dataclass(frozen=True, eq=False)
class Ground:
    """A levelled component: cameras, their true centres (n, 3), depth maps, and what these show in truth (h, w, 3)."""

    site: str
    component: int
    cameras: tuple[Camera, ...]
    true_centres: Array
    maps: tuple[DepthMap, ...]
    shown: tuple[Array32, ...]
    bias_m: Array


def ground_components(run: Path) -> Iterator[Ground]:
    """The ground components of a run that have depth maps enough for three photos to agree."""
    site = site_of(run)
    world = World(SiteOptions(**truth_of(run)["options"]))
    scene = world.scene(dates_of(world.options).ground)
    for number, component in enumerate(stage(run, "ground0.reconstruct")):
        maps = stage(run, f"ground0-{number}.depths", needed=False) or []
        if len(maps) < MIN_MAPS:
            print(f"{run.name} {number}: {len(component.cameras)} cameras, {len(maps)} depth maps", flush=True)
            continue
        cameras = component.transformed(laid(component.cameras, {m.camera.image: m.camera for m in maps})).cameras
        lenses = {camera.image: camera for camera in cameras}
        shown = [true_points(scene, m, lenses[m.camera.image], site.cameras[m.camera.image]) for m in maps]
        centres = np.array([site.cameras[camera.image].centre for camera in cameras])
        yield Ground(run.name, number, cameras, centres, tuple(maps), tuple(shown), site.bias_m)


def true_points(scene: Scene, depth_map: DepthMap, found: Camera, true: Camera) -> Array32:
    """What the pixels of an undistorted photo show (h, w, 3), ENU metres; NaN in the sky.

    The photo was taken through the true lens, and undistorted by the one that the reconstruction found.
    """
    h, w = depth_map.depth.shape
    px = found.intrinsics.resized(w, h).px_from_cam(depth_map.camera.intrinsics.rays(pixels(h, w)))
    inside = ((px > 0) & (px < [w, h])).all(axis=1)
    rays = true.intrinsics.resized(w, h).rays(px[inside]) @ true.cam_from_world.rotation
    far = scene.cast(true.centre, rays).distance[:, None]
    shown = np.full((h * w, 3), np.nan, np.float32)
    shown[inside] = true.centre + np.where(np.isfinite(far), far, np.nan) * rays
    return shown.reshape(h, w, 3)


@dataclass(frozen=True, eq=False)
class Surface:
    """What a picture shows: pixels (n, 2), points (n, 3), and unit normals (n, 3) towards the viewer."""

    px: Array
    xyz: Array
    normals: Array

    @classmethod
    def of(cls, shown: Array32, away: Array) -> Surface:
        """Of points (h, w, 3) that are seen in directions (3,) or (h, w, 3)."""
        across, down = (np.roll(shown, -3, axis=k) - np.roll(shown, 3, axis=k) for k in (1, 0))
        normals = np.cross(across, down).astype(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            normals /= np.linalg.norm(normals, axis=2, keepdims=True)
            normals *= -np.sign(np.sum(normals * away, axis=2, keepdims=True))
        known = np.isfinite(shown).all(axis=2)
        return cls(pixels(*shown.shape[:2])[known.ravel()], shown[known].astype(np.float64), normals[known])

    def some(self, rng: np.random.Generator, *, wall: bool) -> int | None:
        """A point at random on a wall, or on what is flat; None where there is none."""
        up = self.normals[:, 2]
        index = np.flatnonzero(np.abs(up) < 0.3 if wall else up > 0.95)
        return int(rng.choice(index)) if len(index) else None


@dataclass(frozen=True, eq=False)
class Answer:
    """Pixels (n, 2) of a photo that are said to be pixels (n, 2) of a tile; not `told`, they serve the way back only.

    Where `wrong` ones end among right ones they win.
    """

    px_a: Array
    px_b: Array
    wrong: Mask
    told: Mask

    def warp(self, shape_a: tuple[int, ...], shape_b: tuple[int, ...]) -> Warp:
        """Both ways; a pixel of b leads back to the mean of the pixels of a that lead to it."""
        flow_a, flow_b = (np.full((*shape, 2), -1.0, np.float32) for shape in (shape_a, shape_b))
        sure_a, sure_b = np.zeros(shape_a, np.float32), np.zeros(shape_b, np.float32)
        column, row = self.px_a[self.told].astype(np.intp).T
        flow_a[row, column], sure_a[row, column] = self.px_b[self.told], 1.0
        inside = ((self.px_b >= 0) & (self.px_b < shape_b[::-1])).all(axis=1)
        for part in (inside & ~self.wrong, inside & self.wrong):
            cell = np.ravel_multi_index(tuple(self.px_b[part].astype(np.intp).T[::-1]), shape_b)
            count = np.bincount(cell, minlength=sure_b.size).reshape(shape_b)
            total = [np.bincount(cell, px, sure_b.size).reshape(shape_b) for px in self.px_a[part].T]
            hit = count > 0
            flow_b[hit], sure_b[hit] = np.stack(total, axis=-1)[hit] / count[hit, None], 1.0
        return Warp(flow_a, sure_a, flow_b, sure_b)


@dataclass(eq=False)
class TileOracle:
    """A matcher that knows what all photos and tiles show, and fails as learned ones do.

    Right answers are off by a smooth field of `noise_px` of the tile (standard deviation, each way). `wrong_patches` of
    a photo's patches are said to be anywhere in the tile: they make 30 % of the matches (office park 0), for they stay
    whole where right answers are lost at edges. Where a photo and a tile share nothing, `false_share` of the
    pairs get a falsehood that fits in space, as repeated facades give: a wall of the photo is laid on one of the tile,
    or ground on ground. Half of these have depth enough to count, with 40 to 600 matches. All that is said has full
    confidence, is consistent both ways, and is the same whenever the pair is asked for. Nothing is right where `blind`.
    `seconds` counts what this costs.

    `OracleMatcher` would do for a small world: it takes seconds per pair here, and its errors do not find back.
    """

    ground: Ground
    airborne: AirborneTiles
    noise_px: float = 1.5
    wrong_patches: float = 0.14
    false_share: float = 0.5
    tolerance_m: float = 0.5
    min_shared: float = 0.02
    blind: bool = False
    seconds: float = field(default=0.0, init=False)

    def __call__(self, a: Raster, b: Raster) -> Warp:
        start = time.process_time()
        photo, k = self._photos[a.rgb.tobytes()], self._tiles[b.rgb.tobytes()]
        tile, rng, answer = self.airborne.tiles[k], np.random.default_rng([photo, k]), None
        if not self.blind and self._shared[photo, k] >= self.min_shared:
            answer = self._right(self._surfaces[photo], tile, rng)
        elif rng.uniform() < self.false_share:
            answer = self._false(self._surfaces[photo], tile, rng)
        nothing = Answer(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, bool), np.zeros(0, bool))
        warp = (answer or nothing).warp(a.mask.shape, b.mask.shape)
        self.seconds += time.process_time() - start
        return warp

    @cached_property
    def _photos(self) -> dict[bytes, int]:
        return {m.rgb.tobytes(): k for k, m in enumerate(self.ground.maps)}

    @cached_property
    def _tiles(self) -> dict[bytes, int]:
        return {tile.raster.rgb.tobytes(): k for k, tile in enumerate(self.airborne.tiles)}

    @cached_property
    def _surfaces(self) -> list[Surface]:
        true = {c.image: centre for c, centre in zip(self.ground.cameras, self.ground.true_centres, strict=True)}
        pairs = zip(self.ground.shown, self.ground.maps, strict=True)
        return [Surface.of(shown, shown - true[m.camera.image]) for shown, m in pairs]

    @cached_property
    def _shared(self) -> Array:
        """Share (n photos, n tiles) of what a photo shows that a tile shows as well."""
        rng = np.random.default_rng(0)
        drawn = np.stack([s.xyz[rng.integers(0, len(s.xyz), 400)] for s in self._surfaces])
        return shown_shares(self.airborne, drawn, self.tolerance_m)

    def _seen(self, px: Array, xyz: Array, tile: Tile) -> Answer:
        """Where pixels (n, 2) with points (n, 3) are in a tile, if it shows these points."""
        px_b = self.airborne.px_from_enu(tile.render, xyz) - [tile.left, tile.top]
        h, w = tile.raster.mask.shape
        index = np.flatnonzero(((px_b >= 0) & (px_b < [w, h])).all(axis=1))
        column, row = px_b[index].astype(np.intp).T
        gap = np.linalg.norm(tile.xyz_enu[row, column] - xyz[index], axis=1)
        index = index[gap <= self.tolerance_m]
        return Answer(px[index], px_b[index], np.zeros(len(index), bool), np.ones(len(index), bool))

    def _right(self, surface: Surface, tile: Tile, rng: np.random.Generator) -> Answer:
        seen, shape = self._seen(surface.px, surface.xyz, tile), tile.raster.mask.shape
        column, row = seen.px_b.astype(np.intp).T
        px_b = seen.px_b + smooth_field(shape, self.noise_px, rng)[row, column]
        patch, within = np.divmod(seen.px_a, PATCH_PX)
        counts, index = patch.max(axis=0, initial=0).astype(int) + 1, tuple(patch.astype(int).T)
        size = PATCH_PX / rng.uniform(3.0, 6.0, (*counts, 1))  # in the tile, as a wall some 20 m away has it
        corner = rng.uniform(size=(*counts, 2)) * (np.array(shape[::-1]) - size)
        wrong = (rng.uniform(size=counts) < self.wrong_patches)[index]
        elsewhere = corner[index] + within / PATCH_PX * size[index]
        return replace(seen, px_b=np.where(wrong[:, None], elsewhere, px_b), wrong=wrong)

    def _false(self, own: Surface, tile: Tile, rng: np.random.Generator) -> Answer | None:
        others = Surface.of(tile.xyz_enu, self.airborne.forward_enu(tile.render))
        for _ in range(6):
            wall = bool(rng.uniform() < 2 / 3)
            here, there = own.some(rng, wall=wall), others.some(rng, wall=wall)
            if here is None or there is None:
                continue
            headings = [np.arctan2(n[1], n[0]) for n in (own.normals[here], others.normals[there])]
            turn = headings[1] - headings[0] if wall else rng.uniform(0, 2 * np.pi)
            arms = own.xyz - own.xyz[here]
            near = np.linalg.norm(arms, axis=1) < rng.uniform(1.5, 4.0)
            moved = arms[near] @ Rotation.from_euler("z", turn).as_matrix().T + others.xyz[there]
            answer = self._seen(own.px[near], moved, tile)
            if len(answer.told) >= MIN_FALSE:
                return replace(answer, told=rng.permutation(len(answer.told)) < rng.integers(MIN_FALSE, MAX_FALSE))
        return None


def searched(ground: Ground, airborne: Airborne, seeds: Sequence[int], noise_px: float) -> Iterator[dict[str, Any]]:
    """A row for each search of a component on an airborne model: one for all pairs, and a cascade for each seed."""
    true_tiles = airborne_tiles(airborne.renders, enu_from_render=airborne.true_from_render)
    oracle = TileOracle(ground, true_tiles, noise_px, blind=ground.site != airborne.site)
    for mode, seed in [("exhaustive", seeds[0]), *(("cascade", seed) for seed in seeds)]:
        given: dict[str, Any] = {"enu_from_render": airborne.enu_from_render, "rng": np.random.default_rng(seed)}
        start, oracle.seconds = time.process_time(), 0.0
        if mode == "exhaustive":
            found = exhaustive(ground.maps, airborne.renders, oracle, **given)
        else:
            found = cascade(ground.maps, airborne.renders, oracle, **given)
        yield {
            "site": ground.site,
            "component": ground.component,
            "on": airborne.site,
            "cameras": len(ground.cameras),
            "tile_pixel_m": true_tiles.pixel_m,
            "mode": mode,
            "seed": seed,
            "seconds": time.process_time() - start,
            "oracle_s": oracle.seconds,
            **judged(found, ground, airborne),
        }


def judged(found: Registration, ground: Ground, airborne: Airborne) -> dict[str, Any]:
    """What the search says of itself, and what the truth says: also of a place that the search does not believe."""
    own_site = ground.site == airborne.site
    told = {"registered": found.registered, "reason": found.reason, "inlier_ratio": found.inlier_ratio}
    row = {**told, **found.diagnostics, "wrong": found.registered and not own_site}
    if found.enu_from_level is None or not own_site:
        return row
    centres = found.enu_from_level.apply([camera.centre for camera in ground.cameras])
    errors = centres - ground.true_centres - ground.bias_m
    on_model = centres - airborne.placed_from_true.apply(ground.true_centres)
    lengths = np.linalg.norm(errors, axis=1)
    return row | {
        "own_m": float(lengths.mean()),
        "own_median_m": float(np.median(lengths)),
        "relative_m": float(np.linalg.norm(errors - errors.mean(axis=0), axis=1).mean()),
        "on_model_m": float(np.linalg.norm(on_model, axis=1).mean()),
        "wrong": found.registered and bool(np.median(lengths) > WRONG_M),
    }


def views_of(surface_points: Array, pixel: float, n_tiles: int | None) -> list[View]:
    """Of the model's own pixel, or so much finer that the views make about that many tiles."""
    views = [nadir_view(surface_points, pixel), *oblique_views(surface_points, pixel)]
    if n_tiles is None:
        return views
    finer = np.linspace(1.0, 5.0, 161)
    counts = [sum(len(tiles((round(v.shape[0] * f), round(v.shape[1] * f)))) for v in views) for f in finer]
    by = float(finer[np.argmin(np.abs(np.array(counts) - n_tiles))])
    fine = RenderOptions(max_px=1_000_000)
    return [nadir_view(surface_points, pixel / by, fine), *oblique_views(surface_points, pixel / by, fine)]


def smooth_field(shape: tuple[int, ...], sigma: float, rng: np.random.Generator) -> Array:
    """Random vectors (h, w, 2) that change over `SMOOTH_PX`."""
    h, w = shape
    coarse = rng.standard_normal((h // SMOOTH_PX + 3, w // SMOOTH_PX + 3, 2))
    smooth = np.asarray(cv2.resize(coarse, (w, h), interpolation=cv2.INTER_CUBIC), dtype=np.float64)
    return np.asarray(sigma * smooth / np.sqrt(np.mean(smooth**2)))


def pixels(h: int, w: int) -> Array:
    """Centres (h * w, 2) of all pixels."""
    return np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), axis=-1).reshape(-1, 2)


def laid(cameras: Sequence[Camera], places: Mapping[str, Camera]) -> Similarity:
    """The similarity that best lays cameras on those of the same names."""
    known = [camera for camera in cameras if camera.image in places]
    return umeyama([camera.centre for camera in known], [places[camera.image].centre for camera in known])


def stage(run: Path, name: str, *, needed: bool = True) -> Any:
    """What a stage of the finished run has left in its cache; None where it has not come to a stage not `needed`."""
    try:
        return read_stage(run / "result", name)
    except FileNotFoundError as error:
        if needed:
            raise SystemExit(f"{error}; or finish it with benchmarks/paper_tables.py") from None
        return None


def truth_of(run: Path) -> dict[str, Any]:
    """What the simulation knows of its site."""
    return dict(json.loads((run / "site/truth.json").read_text()))


def site_of(run: Path) -> Site:
    """The simulated site of a run."""
    truth = truth_of(run)
    frame = place_of(SiteOptions(**truth["options"]))
    return Site(run / "site", frame, np.array(truth["bias_m"]), np.array(truth["covariance"]))


def show(rows: Sequence[dict[str, Any]]) -> None:
    """Every search on a line, with what it costs against the search of all pairs before it."""
    table: list[list[Any]] = []
    by_all: dict[str, Any] = {}
    for row in rows:
        by_all = row if row["mode"] == "exhaustive" else by_all
        own_s, all_s = (r["seconds"] - r["oracle_s"] for r in (row, by_all))
        place = [row["site"], row["component"], "its own" if row["on"] == row["site"] else row["on"]]
        counts = [row["cameras"], *(f"{row[name]:.0f}" for name in ("photos", "tiles"))]
        pairs = [f"{row['pairs']:.0f}", f"{row['pairs'] / row['photos']:.1f}", f"{row['pairs'] / by_all['pairs']:.1%}"]
        seconds = [f"{own_s:.1f}", f"{own_s / all_s:.0%}", f"{row['oracle_s']:.1f}"]
        status = "WRONG" if row["wrong"] else "REGISTERED" if row["registered"] else "NOT_REGISTERED"
        errors = [f"{row[name]:.2f}" if name in row else "" for name in ("own_m", "on_model_m", "relative_m")]
        scores = f"{row.get('score', 0):.0f}, {row.get('second_score', 0):.0f}"
        table.append(
            [*place, *counts, row["mode"], row["seed"], *pairs, *seconds, status, *errors, scores, row["reason"]]
        )
    print_table(HEADINGS, table)


if __name__ == "__main__":
    main()
