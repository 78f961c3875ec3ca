# SPDX-License-Identifier: Apache-2.0
"""Control of one component compared with its registration: what is wrong, and the correction if it is used."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skymoor.control.adjust import FREE_M2, IDENTIFIABLE, Adjusted, Snooped, adjust, snoop
from skymoor.control.given import Control
from skymoor.control.observations import Linear, Observations, PosedCameras, locate
from skymoor.control.rows import ControlRow, Totals, Use, in_metres, row_of, row_values, totals_of
from skymoor.geo import EnuFrame
from skymoor.types import Array

TO_CHECK = "check CE90, LE90 and the vertical datum of both"


@dataclass(frozen=True, eq=False)
class ControlResult:
    """What control says of a component; `adjusted` is the correction where it was `used`.

    `reason` says why it was not, although it was to be; `notes` are sentences for a person.
    """

    rows: tuple[ControlRow, ...]
    totals: Totals
    used: bool = False
    reason: str = ""
    notes: tuple[str, ...] = ()
    adjusted: Adjusted | None = None


@dataclass(frozen=True, eq=False)
class Prior:
    """What the registration says of the eight parameters: covariance (8, 8) about `centre` (3,), see `observations`.

    `reference_known` is False where the reference's own accuracy is not known: the covariance is relative to it then.
    `heights_known` is False where nothing is known of the heights.
    """

    covariance: Array
    centre: Array
    reference_known: bool = True
    heights_known: bool = True

    @property
    def believed(self) -> Array:
        """The covariance (8, 8), with a position or a height that may be anything where they are not known."""
        unknown = [not self.reference_known] * 2 + [not (self.reference_known and self.heights_known)]
        return self.covariance + np.diag([0.0] * 4 + [FREE_M2 if one else 0.0 for one in unknown] + [0.0])


def examine(control: Control, posed: PosedCameras, frame: EnuFrame, prior: Prior) -> ControlResult | None:
    """Compare control with a registered component, and find the correction if it is to be used.

    None where no photo of the component has any of it.
    """
    located = locate(control, posed, prior.centre)
    observed = Observations.of(located, control.bars, frame, prior.centre)
    unusable = [ControlRow(one.name, one.kind, "unusable", one.n_photos, reason=one.reason) for one in located]
    unusable = [row for row in unusable if row.reason]
    if not len(observed):
        return ControlResult(tuple(unusable), totals_of([])) if unusable else None
    found, linear = snoop(observed, prior.believed), observed.at()
    contradiction = _contradiction(observed, found)
    rows = []
    for k in range(len(observed)):
        row = row_of(observed, linear, prior.covariance, k, heights_known=prior.heights_known)
        use: Use = "check" if k in found.kept or contradiction else "wrong"
        rows.append(replace(row, use=use, test=float(found.tests[k]), limit=float(found.limits[k])))
    notes = _wrong(observed, found, linear)
    if contradiction:
        notes = [] if control.use else [contradiction]
    result = ControlResult((*rows, *unusable), totals_of(rows), notes=(*notes, *_notes(observed, prior)))
    if contradiction:
        return replace(result, reason=contradiction) if control.use else result
    adjusted = adjust(observed, prior.believed, found.kept)
    if adjusted.disagreement_m is not None:
        far = f"control and reference differ by {in_metres(adjusted.disagreement_m)}, more than both accuracies explain"
        if not control.use:
            return replace(result, notes=(*result.notes, f"{far}; {TO_CHECK}"))
        if sum(k < len(observed.places) for k in found.kept) < IDENTIFIABLE:
            reason = f"{far}, and it takes {IDENTIFIABLE} surveyed positions that agree to say that control is right"
            return replace(result, reason=reason)
        result = replace(result, notes=(*result.notes, f"{far}: positions follow the control alone; {TO_CHECK}"))
    return _used(result, observed, found, adjusted) if control.use else result


def _used(result: ControlResult, observed: Observations, found: Snooped, adjusted: Adjusted) -> ControlResult:
    """With the correction, and what remains after it."""
    after, rows = observed.at(adjusted.correction).misclosure, list(result.rows)
    shift = adjusted.correction[7]
    for k, block in enumerate(observed.at().rows):
        left = -after[block]
        if k < len(observed.places):  # the focal length stays what it is
            left = left - shift * observed.places[k].away[: len(left)]
        rows[k] = replace(
            rows[k], use="control" if k in found.kept else "wrong", after_m=row_values(left, rows[k].kind)
        )
    return replace(result, rows=tuple(rows), used=True, adjusted=adjusted)


def _contradiction(observed: Observations, found: Snooped) -> str:
    """Why nothing can be concluded from control that contradicts itself; empty where it can be said what is wrong."""
    n, wrong = len(observed.places), [k for k in range(len(observed)) if k not in found.kept]
    n_wrong = sum(k < n for k in wrong)
    few = n_wrong and (n < IDENTIFIABLE or 2 * n_wrong >= n)
    if wrong and (few or 2 * len(wrong) >= len(observed)):
        names = ", ".join(observed.names[k] for k in wrong[:3])
        return f"it contradicts itself ({names} and others), and too little of it agrees to say which is wrong"
    return ""


def _wrong(observed: Observations, found: Snooped, linear: Linear) -> list[str]:
    """One line for each observation that is wrong."""
    return [
        f"{name} contradicts the others: test value {found.tests[k]:.0f}, at most {found.limits[k]:.0f} is chance; "
        f"its residual is {in_metres(-linear.misclosure[linear.rows[k]])}"
        for k, name in enumerate(observed.names)
        if k not in found.kept
    ]


def _notes(observed: Observations, prior: Prior) -> list[str]:
    """What a person must know."""
    notes, n = [], len(observed.places)
    if 0 < n < IDENTIFIABLE:
        finds = "would not be noticed" if n == 1 else "would be noticed, but not which one it is"
        notes.append(
            f"{n} surveyed position{'s' if n > 1 else ''}: a wrong one {finds}; from {IDENTIFIABLE} on it is named"
        )
    if n and not prior.reference_known:
        notes.append(
            "the accuracy of the reference is unknown: residuals are compared with the relative accuracy alone, so an "
            "offset of the reference shows as one of all points"
        )
    return notes
