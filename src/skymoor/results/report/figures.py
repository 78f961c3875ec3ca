# SPDX-License-Identifier: Apache-2.0
"""Numbers as drawings: histograms in SVG, whose colours and letters the page's style decides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from skymoor.results.report.words import MINUS

WIDTH, HEIGHT, FOOT, BINS = 320, 150, 22, 31


@dataclass(frozen=True)
class Distribution:
    """How often which value occurs: `counts` of classes of equal width from -reach to +reach; outliers lie beyond.

    `spread` is 1.4826 median absolute deviations, of normal errors their standard deviation.
    """

    n: int
    median: float
    spread: float
    reach: float
    counts: list[int]


def distribution(values: ArrayLike) -> Distribution | None:
    """Of the finite values; None without any."""
    data = np.asarray(values, dtype=np.float64).ravel()
    data = data[np.isfinite(data)]
    if not len(data):
        return None
    middle = float(np.median(data))
    spread = 1.4826 * float(np.median(np.abs(data - middle)))
    reach = max(float(np.percentile(np.abs(data), 98)), 1e-3)
    counts, _ = np.histogram(data, BINS, (-reach, reach))
    return Distribution(len(data), middle, spread, reach, counts.tolist())


def histogram(values: ArrayLike, label: str, unit: str = "m") -> Markup:
    """How often which value occurs, over all but the outliers; zero is marked, and the words say middle and spread."""
    found = distribution(values)
    if found is None:
        return Markup("")
    middle, spread, reach, counts = found.median, found.spread, found.reach, np.array(found.counts)
    floor, step = HEIGHT - FOOT, WIDTH / BINS
    bars = "".join(
        f'<rect x="{k * step + 0.5:.1f}" y="{floor - tall:.1f}" width="{step - 1:.1f}" height="{tall:.1f}"/>'
        for k, tall in enumerate((floor - 6) * counts / max(1, counts.max()))
    )
    words = f"{label}: median {middle:+.2f} {unit}, spread {spread:.2f} {unit}, {found.n} values"
    marks = "".join(
        f'<text x="{x}" y="{HEIGHT - 6}" text-anchor="{anchor}">{text}</text>'
        for x, anchor, text in (
            (2, "start", f"{MINUS}{reach:.2g}"),
            (WIDTH / 2, "middle", "0"),
            (WIDTH - 2, "end", f"+{reach:.2g} {unit}"),
        )
    )
    drawing = (
        '<figure class="histogram"><svg viewBox="0 0 {w} {h}" role="img" aria-label="{words}">'
        '<g class="bars">{bars}</g><path class="axis" d="M0 {floor}H{w}M{half} 0V{floor}"/>{marks}</svg>'
        "<figcaption><b>{label}</b> median {middle} {unit}, spread {spread} {unit}</figcaption></figure>"
    )
    return Markup(drawing).format(
        w=WIDTH,
        h=HEIGHT,
        words=words,
        bars=Markup(bars),
        floor=floor,
        half=WIDTH / 2,
        marks=Markup(marks),
        label=label,
        middle=f"{middle:+.2f}".replace("-", MINUS),
        spread=f"{spread:.2f}",
        unit=unit,
    )
