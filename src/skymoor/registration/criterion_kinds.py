# SPDX-License-Identifier: Apache-2.0
"""The kinds of acceptance criteria: meaning, limit and remedy, for screen, report, summary and documentation."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Literal

Scope = Literal["airborne", "ground", "walls", "tiles", "map"]
"""Registrations that are checked: airborne or ground ones, the latter of one `ground.method`, on the map, or all."""

NARROW_HEIGHTS = "narrow the flying heights (match.min_height_m, match.max_height_m)"
MORE_IN_COMMON = (
    "Use a reference (or airborne photos) and photos of the same season and sharpness, take more photos with more "
    "overlap, or choose another matcher (match.matcher, ground.matcher)."
)


@dataclass(frozen=True)
class Kind:
    """One kind of criterion.

    Attributes:
        name: of the value, for tables.
        scopes: registrations that are checked.
        at: whether the limit is the least or the most that passes; empty where that is not known.
        refusal: the reason of a failure, with `{value}`, `{limit}` and diagnostics of the registration by name.
        meaning: what is checked, and what a failure means.
        limit: where the limit comes from, with the options that set it.
        remedy: what helps where it fails.
        spec, unit: how value and limit are written; "%" is of shares.
    """

    name: str
    scopes: tuple[Scope, ...]
    at: Literal["least", "most", ""]
    refusal: str
    meaning: str
    limit: str
    remedy: str
    spec: str = ".0f"
    unit: str = ""

    def written(self, number: float | None) -> str:
        """A value or a limit with its unit; "unknown" where there is none."""
        if number is None or not isfinite(number):
            return "unknown"
        text = format(100 * number if self.unit == "%" else number, self.spec)
        text = f"{float(text):.0f}" if "e+" in text else text  # 1200, not 1.2e+03
        text = text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text
        return f"{text}{self.unit}" if self.unit == "°" else f"{text} {self.unit}".rstrip()

    def written_limit(self, number: float | None) -> str:
        """The limit with the side that passes."""
        return f"at {self.at} {self.written(number)}" if self.at else self.written(number)


KINDS: dict[str, Kind] = {
    "map_hypotheses": Kind(
        name="hypotheses in the reference",
        scopes=("airborne",),
        at="least",
        refusal="the reference is too small for the model at any height that was searched",
        meaning="The reference must be large enough to hold the model at one of the flying heights that are searched.",
        limit="at least 1",
        remedy=f"Use a reference that covers the whole site and its surroundings, or {NARROW_HEIGHTS}.",
    ),
    "match_score": Kind(
        name="match score",
        scopes=("airborne",),
        at="least",
        refusal="match score {value} is below the minimum of {limit}",
        meaning="The render must fit the reference at the best hypothesis; "
        "a low score means that nothing in the reference looks like the model.",
        limit="at least register.min_score",
        remedy=f"Check that the reference covers the site and looks like the photos, {NARROW_HEIGHTS}, "
        "or take more photos with more overlap.",
        spec=".1f",
    ),
    "false_alarm": Kind(
        name="false-alarm probability",
        scopes=("airborne",),
        at="most",
        refusal="match score {search_score:.0f} and {cells:.0f} agreeing cells of {covered_cells:.0f} are not "
        "significant: decoys reach {decoy_score:.0f} and {decoy_cells:.0f} in this reference (false-alarm probability "
        "{value})",
        meaning="Match score and agreement must be significantly above those of decoys: mirrored and stretched "
        "renders, which match nowhere, searched and matched in the same reference.",
        limit="at most register.max_false_alarm",
        remedy=f"Check that the reference covers the site and looks like the photos, {NARROW_HEIGHTS}, "
        "or photograph a larger area: more content makes the score more significant.",
        spec=".3g",
        unit="%",
    ),
    "agreement": Kind(
        name="chance of the agreement in plan",
        scopes=("airborne",),
        at="most",
        refusal="matches agree in {cells:.0f} of {covered_cells:.0f} independent cells, as those of a decoy do with "
        "probability {value}; at most {limit} is allowed",
        meaning="The share of independent cells of the model in which matches agree with the transform in plan must be "
        "larger than decoys usually reach; heights play no part.",
        limit="at most register.max_chance_agreement",
        remedy=MORE_IN_COMMON,
        spec=".2g",
        unit="%",
    ),
    "competing_score": Kind(
        name="match score over a competing hypothesis",
        scopes=("airborne",),
        at="least",
        refusal="a competing hypothesis scores {second_score:.0f}, the best {value}; at least {limit} is required",
        meaning="The best hypothesis must score clearly higher than every other; "
        "similar houses, fields or woods make several positions look alike.",
        limit="at least register.min_score_margin times the competing score",
        remedy=f"Compare the hypotheses in the report; cut the reference to the area of the site, or {NARROW_HEIGHTS}, "
        "so that the wrong ones are not searched.",
        spec=".1f",
    ),
    "estimate": Kind(
        name="estimated transforms",
        scopes=("airborne", "walls", "tiles"),
        at="least",
        refusal="no transform could be estimated from the matches",
        meaning="The matches must determine a similarity transform; "
        "too few of them, or matches along one line, leave it open.",
        limit="at least 1",
        remedy=MORE_IN_COMMON,
    ),
    "inliers": Kind(
        name="inliers",
        scopes=("airborne",),
        at="least",
        refusal="{value} matches are inliers; at least {limit} are required",
        meaning="Enough matches must agree with the transform; few mean that model and reference differ too much.",
        limit="at least register.min_inliers",
        remedy=MORE_IN_COMMON,
    ),
    "inlier_ratio": Kind(
        name="inlier ratio",
        scopes=("walls", "tiles"),
        at="least",
        refusal="inlier ratio {value} is below the minimum of {limit}",
        meaning="Enough of the matches must agree with the transform; "
        "a low ratio means a wrong position, or a site that has changed.",
        limit="at least ground.walls.acceptance.min_inlier_ratio",
        remedy="Take more photos at the time of the year and of the day of the airborne ones.",
        spec=".1f",
        unit="%",
    ),
    "cells": Kind(
        name="independent cells with inliers",
        scopes=("airborne", "walls", "tiles"),
        at="least",
        refusal="inliers lie in {value} independent cells; at least {limit} are required",
        meaning="Inliers must be spread over the model, because neighbouring matches repeat each other; "
        "few cells mean that one corner alone supports the transform.",
        limit="at least register.min_cells, for ground photos ground.walls.acceptance.min_cells",
        remedy="Take photos that cover more of the site; for ground photos, of more walls that the airborne ones show.",
    ),
    "tilt": Kind(
        name="tilt of the levelled model",
        scopes=("airborne", "walls", "tiles"),
        at="most",
        refusal="the levelled model would be tilted by {value}; at most {limit} is allowed",
        meaning="The transform must keep the levelled model upright; "
        "a large tilt means that up was estimated wrongly, or that the position is wrong.",
        limit="at most register.max_tilt_deg, for ground photos ground.walls.acceptance.max_tilt_deg",
        remedy="Take oblique photos as well as nadir ones; for ground photos, take photos with more vertical edges.",
        spec=".1f",
        unit="°",
    ),
    "wall_hypotheses": Kind(
        name="hypotheses from walls",
        scopes=("walls",),
        at="least",
        refusal="no wall of the model matches any wall of the airborne model",
        meaning="At least one wall must look alike from the ground and from the air; "
        "otherwise there is no hypothesis to check.",
        limit="at least 1",
        remedy="Take photos of walls that the airborne photos show, and airborne photos at a slant that show them.",
    ),
    "contrast": Kind(
        name="contrast of the agreement with airborne walls",
        scopes=("walls",),
        at="least",
        refusal="contrast {value} of the agreement with the airborne walls is below the minimum of {limit}",
        meaning="The photos must agree with the airborne walls much better at the hypothesis than a few metres aside, "
        "where walls still overlap by coincidence; otherwise the place may be right and the position a few metres off.",
        limit="at least ground.walls.acceptance.min_contrast",
        remedy="Take more photos that overlap and go round a corner: two sides of a house determine what one cannot; "
        "the figure of the walls in the report shows what was compared.",
        spec=".1f",
    ),
    "chance_of_evidence": Kind(
        name="chance of as much evidence at a wrong place",
        scopes=("walls",),
        at="most",
        refusal="a wrong place agrees as well in plan ({plan_score:.1f}) and in the matches of its photos "
        "({cells:.0f} independent cells) with probability {value}; at most {limit} is allowed",
        meaning="Agreement in plan (walls on height steps, free space, ground on the orthophoto) and the number of "
        "places where matches of the photos agree must exceed what mirrored and misplaced components reach.",
        limit="at most ground.walls.acceptance.max_chance",
        remedy="Take more photos that overlap, show the ground before the walls and go round a corner, "
        "and airborne photos at a slant that show walls.",
        spec=".2g",
        unit="%",
    ),
    "likelihood_ratio": Kind(
        name="odds of this place over those of the next",
        scopes=("walls",),
        at="least",
        refusal="another place is nearly as likely: the ratio of their odds is {value}; at least {limit} is required",
        meaning="Where walls and ground repeat themselves, the best place must be much more likely than any other.",
        limit="at least ground.walls.acceptance.min_ratio",
        remedy="Take photos that show where a repetition ends, such as the corner of a row of houses; "
        "the figure of the walls in the report shows what was compared.",
        spec=".2g",
    ),
    "min_camera_height": Kind(
        name="camera height above the ground",
        scopes=("walls",),
        at="least",
        refusal="camera height above the ground is {value}; at least {limit} is required",
        meaning="Ground cameras are held by people; cameras in the ground mean a wrong position.",
        limit="at least ground.walls.acceptance.min_height_m",
        remedy="Take more photos that overlap and go round a corner; if the cameras really stood so low, lower "
        "ground.walls.acceptance.min_height_m.",
        spec=".2f",
        unit="m",
    ),
    "max_camera_height": Kind(
        name="camera height above the ground",
        scopes=("walls",),
        at="most",
        refusal="camera height above the ground is {value}; at most {limit} is allowed",
        meaning="Ground cameras are held by people; cameras in the air mean a wrong position.",
        limit="at most ground.walls.acceptance.max_height_m",
        remedy="Take more photos that overlap and go round a corner; if the cameras really stood so high, as on a "
        "mast, raise ground.walls.acceptance.max_height_m.",
        spec=".2f",
        unit="m",
    ),
    "blocked": Kind(
        name="viewing rays that cross walls",
        scopes=("walls",),
        at="most",
        refusal="{value} of the viewing rays cross walls; at most {limit} is allowed",
        meaning="Nothing may stand between the cameras and what they show; "
        "rays through walls mean a position inside or behind a house.",
        limit="at most ground.walls.acceptance.max_blocked",
        remedy="Take more photos that overlap and go round a corner, of walls that the airborne photos show.",
        spec=".1f",
        unit="%",
    ),
    "map_places": Kind(
        name="places on the map",
        scopes=("map",),
        at="least",
        refusal="the walls and the free space of these photos fit nowhere on the reference",
        meaning="Somewhere on the reference most of what the photos show must lie where heights or colours are known.",
        limit="at least 1",
        remedy="Use a reference that covers the site and its surroundings, with a surface model of houses and trees.",
    ),
    "chance_of_lead": Kind(
        name="chance of so large a lead at a wrong place",
        scopes=("map",),
        at="most",
        refusal="the best place ({plan_score:.1f}) does not lead the next one ({second_plan_score:.1f}) enough: "
        "among wrong places alone that happens with probability {value}; at most {limit} is allowed",
        meaning="In plan (walls on height steps, free space, ground on the orthophoto) the best place must lead all "
        "others by more than the highest of many wrong places lead each other.",
        limit="at most ground.on_map.max_chance",
        remedy="Take more photos that overlap and go round corners of houses, use a smaller or sharper reference, "
        "or add airborne photos.",
        spec=".2g",
        unit="%",
    ),
    "tile_hypotheses": Kind(
        name="hypotheses from tiles",
        scopes=("tiles",),
        at="least",
        refusal="none of {pairs:.0f} pairs of photo and tile yields a transform",
        meaning="At least one photo must match a tile of the airborne renders, or there is no hypothesis to check.",
        limit="at least 1",
        remedy="Take photos of what the airborne photos show, or set ground.method to walls, the default.",
    ),
    "agreeing_photos": Kind(
        name="photos that agree",
        scopes=("tiles",),
        at="least",
        refusal="{value} photos agree on the best hypothesis; at least {limit} are required",
        meaning="Several photos must support the hypothesis, each with enough inliers; "
        "one photo alone can be misled by a facade that repeats.",
        limit="at least 3, each with 20 inliers",
        remedy="Take more photos that overlap and show what the airborne photos show.",
    ),
    "competing_inliers": Kind(
        name="inliers over a competing hypothesis",
        scopes=("tiles",),
        at="least",
        refusal="a competing hypothesis has {second_score:.0f} inliers, the best {value}; {limit} are required",
        meaning="The best hypothesis must have clearly more inliers than every other elsewhere; "
        "bays and houses that repeat make several positions look alike.",
        limit="at least 1.25 times the inliers of the competing hypothesis",
        remedy="Take photos that show where the repetition ends, such as the corner of a row of houses.",
        spec=".1f",
    ),
    "conflict": Kind(
        name="conflict with another component",
        scopes=("ground",),
        at="most",
        refusal="{value} of what both models show contradicts {other}",
        meaning="A component must not stand in the free space of one that was registered with more confidence.",
        limit="at most 50 %",
        remedy="Take more photos that overlap and go round a corner, and some that connect the components.",
        spec=".0f",
        unit="%",
    ),
    "control_points": Kind(
        name="surveyed positions that agree",
        scopes=("airborne", "map"),
        at="least",
        refusal="{value} surveyed positions agree; at least {limit} are required",
        meaning="A component that was not found on the map is placed by control alone: its points and known camera "
        "positions must agree with one similarity, after data snooping.",
        limit="at least 4, with --use-control",
        remedy="Measure more control points, each in two photos or more, spread over the whole component.",
    ),
    "other_hypotheses": Kind(
        name="other hypotheses",
        scopes=("ground",),
        at="least",
        refusal="there is no other hypothesis",
        meaning="Where the best hypothesis contradicts another component, there must be another one.",
        limit="at least 1",
        remedy="Take more photos that overlap and go round a corner, or set ground.method to walls, the default.",
    ),
}
