# SPDX-License-Identifier: Apache-2.0
"""What a component's figures mean, in words for the person who has to decide."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from skymoor.results.read import ComponentSummary

NONE, MINUS = "\N{EN DASH}", "\N{MINUS SIGN}"
GROUND_ADVICE = (
    "Take photos that show the same walls as the airborne ones, and more of them that overlap; "
    "the picture of the walls below shows what was compared."
)
TWIN_ADVICE = (
    "Compare the candidate places below. A smaller reference around the site, or a narrower range of flying heights "
    "(match.min_height_m, match.max_height_m), leaves out the wrong ones."
)
AIRBORNE_ADVICE = (
    "See whether the reference shows this place at all, and looks like the photos; then narrow the flying heights "
    "(match.min_height_m, match.max_height_m), or take more photos with more overlap."
)
HEIGHT_ADVICE = (
    "See whether the DSM belongs to this orthophoto and its vertical datum is right; "
    "where the site has changed since, take a newer reference."
)
LOST_ADVICE = "Photos must overlap by more than half: add the ones between, and leave out blurred ones."


def verdict(component: ComponentSummary) -> str:
    """The accuracy one can plan on, or why there is none."""
    if not component.registered:
        reason = component.reason or "no reason was given"
        return f"No place is believed: {reason}."
    if component.ce90_m is None or component.le90_m is None:
        return "Its place is known; this run did not predict how well."
    words = f"Plan on {component.ce90_m:.1f} m horizontally and {component.le90_m:.1f} m in height, nine times of ten."
    relative = component.summary.get("predicted_relative_ce90_m"), component.summary.get("predicted_relative_le90_m")
    if None not in relative:
        words += (
            f" Without the reference's own error, which all its cameras share, "
            f"it is {relative[0]:.2f} m and {relative[1]:.2f} m."
        )
    return words


def advice(component: ComponentSummary) -> str:
    """What to do about a component without a place; empty for one that has it."""
    if component.registered:
        return ""
    if component.set != "airborne":
        return GROUND_ADVICE
    if "another place" in component.reason:
        return TWIN_ADVICE
    return HEIGHT_ADVICE if "heights do not" in component.reason else AIRBORNE_ADVICE


def flattened(tree: object, name: str = "") -> Iterator[tuple[str, object]]:
    """Every leaf of nested objects with its dotted name."""
    if isinstance(tree, Mapping) and tree:
        for key, value in tree.items():
            yield from flattened(value, f"{name}.{key}" if name else str(key))
    else:
        yield name, tree


def number(value: object, digits: int = 2) -> str:
    """For tables: a dash where there is none."""
    return f"{value:.{digits}f}".replace("-", MINUS) if isinstance(value, int | float) else NONE


def share(value: object) -> str:
    """A part of one in percent."""
    return f"{value:.0%}" if isinstance(value, int | float) else NONE


def duration(seconds: float) -> str:
    """Seconds as a person says them."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 3600 else f"{seconds / 3600:.1f} h"


def facts(component: ComponentSummary) -> list[tuple[str, str]]:
    """The figures behind the verdict, each with its name."""
    one: Mapping[str, Any] = component.summary
    told = [
        ("cameras", str(one.get("n_cameras", NONE))),
        ("matches that agree", f"{one.get('n_inliers', NONE)} of {one.get('n_matches', NONE)}"),
        ("misfit (RMSE)", f"{number(one.get('rmse_m'))} m"),
        ("reprojection", f"{number(one.get('reprojection_px'))} px"),
        ("tilt", f"{number(one.get('tilt_deg'))}°"),
    ]
    chance = (one.get("diagnostics") or {}).get("false_alarm_probability")
    return told if chance is None else [*told, ("probability of chance", f"{chance:.2g}")]
