# SPDX-License-Identifier: Apache-2.0
"""A component's figures in words, for the person who has to decide."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import atan2, degrees, hypot
from typing import Any

from skymoor.registration.criteria import criteria_of, kind_of
from skymoor.results.read import ComponentSummary

NONE, MINUS = "\N{EN DASH}", "\N{MINUS SIGN}"
LOST_REMEDY = "Neighbouring photos must overlap by more than half: add photos between them, and leave out blurred ones."
GLOSSARY = {
    "CE90": "Circular error: 90 % of horizontal errors are smaller, in metres.",
    "LE90": "Linear error: 90 % of vertical errors are smaller, in metres.",
    "relative CE90 and LE90": "The same without the error of the reference, which all cameras of a run share.",
    "component": "Photos that structure from motion joined to one model; photos without enough overlap form several.",
    "registered": "The component has a position on Earth that passed all acceptance criteria.",
    "refused": "No position was accepted, and none is written; the status is NOT_REGISTERED.",
    "hypothesis": "A position, azimuth and scale that was considered for a component.",
    "match score": "Agreement of the model seen from above with the reference, in standard deviations of noise.",
    "decoy": "A mirrored, stretched render, which matches nowhere: its best score shows what coincidence reaches.",
    "false-alarm probability": "How likely one more decoy would score as high as the hypothesis.",
    "control": "Surveyed points, camera positions and lengths, which models are compared with or moved onto.",
    "tie point": "A point of the ground or a building that two or more photos show; tie points join the photos.",
    "track length": "The number of photos in which a tie point was found.",
    "reprojection error": "Distance in pixels between a tie point in a photo and where the adjusted model projects it.",
    "bundle adjustment": "Joint least squares of the camera poses, the tie points and the lens.",
    "GSD": "Ground sampling distance: the size of a pixel on the ground, median depth over focal length.",
    "principal point": "Where the axis of the lens meets the image.",
    "distortion": "Radial (k1, k2) and tangential (p1, p2) terms of Brown's model: how a lens differs from a pinhole.",
    "standard deviation of the lens": "The focal length's by its profile, others formal, of the bundle adjustment.",
    "error ellipse": "Holds 90 % of the horizontal errors of a camera; long where the position is least certain.",
    "overlap": "How many photos show a place; something in front of it is not taken into account.",
    "match graph": "Which photos have tie points in common, and how many.",
    "inliers": "Matches that agree with the transform within a limit; the inlier ratio is their share.",
    "residual": "What remains between a match of the model and of the reference after the transform.",
    "contrast": "How far ground photos agree better with the walls at the hypothesis than a few metres aside.",
    "likelihood": "Agreement of ground photos in plan and in matches; wrong placements show what chance reaches.",
    "heights CONFIRMED": "The relief of the reference is the model's; a constant offset of all heights cannot be seen.",
    "heights OFFSET_ONLY": "Heights hang on the mean of a reference that is flat, too coarse, or without relief.",
    "heights NOT_CONFIRMED": "The reference has no heights, or such that contradict the photos: none is written.",
    "DSM": "Digital surface model: heights of the ground with buildings and trees.",
    "ellipsoidal height": "Height above the WGS 84 ellipsoid, tens of metres from the height above sea level.",
}
"""Terms of the report; docs/glossary.md explains more."""


def verdict(component: ComponentSummary) -> str:
    """The expected accuracy, or why the component was refused."""
    if not component.registered:
        return f"Refused: {component.reason or 'no reason was given'}."
    horizontal, vertical = (component.summary.get(f"predicted_relative_{name}_m") for name in ("ce90", "le90"))
    if component.ce90_m is None and horizontal is None:
        return "Registered; this run did not predict an accuracy."
    relative = "" if horizontal is None else f"{horizontal:.2f} m" + (f" and {vertical:.2f} m" if vertical else "")
    if component.ce90_m is None:
        words = f"Expected accuracy (90 %) relative to the reference, whose own accuracy is unknown: {relative}."
        return f"{words} {height_words(component)}".rstrip()
    words = f"Expected accuracy (90 %): {component.ce90_m:.1f} m horizontal (CE90)"
    words += "." if component.le90_m is None else f", {component.le90_m:.1f} m vertical (LE90)."
    if horizontal is not None and vertical is not None:
        words += f" Without the error of the reference, which all its cameras share: {relative}."
    return f"{words} {height_words(component)}".rstrip()


def person_words(summary: Mapping[str, Any]) -> str:
    """What a person stated after a refusal, empty where nobody helped."""
    record = summary.get("person")
    if not record:
        return ""
    by = f" ({record['by']})" if record["by"] else ""
    return f"a person helped with {record['component']}: {record['words']}{by}"


HEIGHT_WORDS = {
    "CONFIRMED": "Heights are confirmed by the relief of the reference, up to a constant offset: a geoid taken for the "
    "ellipsoid cannot be seen in photos",
    "OFFSET_ONLY": "Heights hang on the mean height of the reference, and on its vertical datum",
    "NOT_CONFIRMED": "Heights are not confirmed, and none is written",
}

HEIGHTS_OF_CONTROL = "Heights hang on control"


def height_words(component: ComponentSummary) -> str:
    """What the reference says of the heights; empty for runs of versions that did not ask."""
    points = (component.summary.get("control") or {}).get("points", ())
    hung = any(one["use"] == "control" and one["after_m"][2:] not in ([], [None]) for one in points)
    words = (
        HEIGHTS_OF_CONTROL
        if hung and component.heights == "OFFSET_ONLY"
        else HEIGHT_WORDS.get(component.heights or "", "")
    )
    reason = (component.summary.get("height_verdict") or {}).get("reason", "")
    lean = component.summary.get("lean_m_per_m")
    told = f"{words}{': ' + reason if reason else ''}." if words else ""
    if lean is None:
        return told
    return (
        f"{told} In the orthophoto, buildings lean by {hypot(*lean):.2f} m per metre of height towards "
        f"{degrees(atan2(*lean)) % 360:.0f}°, which was taken out."
    ).lstrip()


def criteria(component: ComponentSummary) -> list[dict[str, Any]]:
    """All acceptance criteria of a component, as texts: name, value, limit and meaning, and whether it `passed`."""
    return [
        {
            "name": kind.name,
            "value": kind.written(one.value),
            "limit": kind.written_limit(one.limit),
            "meaning": kind.meaning,
            "passed": one.passed,
        }
        for one in criteria_of(component.summary)
        for kind in [kind_of(one.kind)]
    ]


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
    """Seconds with a unit that suits them."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 3600 else f"{seconds / 3600:.1f} h"


def area(square_metres: object) -> str:
    """Square metres, hectares or square kilometres, whichever reads best."""
    if not isinstance(square_metres, int | float):
        return NONE
    if square_metres < 1e4:
        return f"{square_metres:.0f} m²"
    return f"{square_metres / 1e4:.2f} ha" if square_metres < 1e6 else f"{square_metres / 1e6:.2f} km²"


def small_length(metres: object) -> str:
    """In centimetres below a metre."""
    if not isinstance(metres, int | float):
        return NONE
    return f"{100 * metres:.1f} cm" if metres < 1 else f"{metres:.2f} m"


def size(n_bytes: float) -> str:
    """Of a file."""
    for unit in ("B", "kB", "MB"):
        if n_bytes < 1000:
            return f"{n_bytes:.0f} {unit}"
        n_bytes /= 1000
    return f"{n_bytes:.1f} GB"


def plain_words(component: ComponentSummary) -> str:
    """Both accuracies for a reader who knows neither CE90 nor LE90; empty where there is none."""
    one, known = component.summary, component.heights != "NOT_CONFIRMED"
    if not component.registered:
        return ""
    pairs = [
        (one.get(f"predicted_{name}ce90_m"), one.get(f"predicted_{name}le90_m") if known else None, where)
        for name, where in (("", "of the truth on Earth"), ("relative_", "of their place on the reference"))
    ]
    told = [
        f"within {plan:.1f} m{'' if height is None else f' in plan and {height:.1f} m in height'} {where}"
        for plan, height, where in pairs
        if plan is not None
    ]
    return f"Nine of ten cameras are expected {', and '.join(told)}." if told else ""


def facts(component: ComponentSummary) -> list[tuple[str, str]]:
    """The figures behind the verdict, each with its name."""
    one: Mapping[str, Any] = component.summary
    error = (one.get("statistics") or {}).get("mean_reprojection_px", one.get("reprojection_px"))
    return [
        ("cameras", str(one.get("n_cameras", NONE))),
        ("inliers", f"{one.get('n_inliers', NONE)} of {one.get('n_matches', NONE)} matches"),
        *_known("RMSE of inliers", one.get("rmse_m"), " m"),
        *_known("reprojection error", error, " px"),
        *_known("tilt", one.get("tilt_deg"), "°"),
        *_height_facts(one),
    ]


def _known(name: str, value: float | None, unit: str) -> list[tuple[str, str]]:
    """A figure with its unit; nothing where there is none, such as of what was refused before it was matched."""
    return [] if value is None else [(name, f"{number(value)}{unit}")]


def _height_facts(one: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The figures behind the verdict on heights."""
    verdict = one.get("height_verdict") or {}
    scale, sigma = verdict.get("scale"), verdict.get("scale_sigma")
    facts = [] if scale is None else [("height scale", f"{number(scale)} ± {number(sigma)}")]
    if verdict.get("spread_m") is not None:
        facts.append(("heights differ by", f"{number(verdict['spread_m'])} m"))
    if verdict.get("resolution_m") is not None:
        facts.append(("detail of the DSM", f"{number(verdict['resolution_m'], 1)} m"))
    return facts
