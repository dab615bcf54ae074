"""Whether the cable changed over the test, in words."""

from __future__ import annotations

import numpy as np

from bench.analysis import FEWEST_VALUES
from bench.model import Verdict
from bench.report.results import Drift, DriftChange, DriftTrend, Results
from bench.report.wording import NBSP, say_count, say_mm, say_number

__all__ = ["describe_drift_section", "list_drift", "warn_about_drift"]

MOST_SENTENCES = 3
"""On the first page; the section has them all."""


def warn_about_drift(results: Results) -> list[str]:
    """Return what the first page must say of a cable that changed: nothing where nothing found matters."""
    sentences = list_drift(results)
    if len(sentences) <= MOST_SENTENCES:
        return sentences
    n = len(sentences) - MOST_SENTENCES
    return [
        *sentences[:MOST_SENTENCES],
        f"And {n} more such {'change' if n == 1 else 'changes'}: see Change over the test.",
    ]


def list_drift(results: Results) -> list[str]:
    """Return one sentence for each change and each trend that matters."""
    drift = results.drift
    if drift is None:
        return []
    trends = [_say_trend(trend) for trend in drift.trends if trend.matters]
    return [*(_say_change(change) for change in drift.changes if change.matters), *trends]


def describe_drift_section(results: Results) -> list[str]:
    """Return the paragraphs below the figure: what was compared with what, and what was found."""
    drift = results.drift
    if drift is None:
        n_ok = sum(verdict == Verdict.OK for verdict in results.cycles.verdict)
        return [
            f"A change over the test shows from {FEWEST_VALUES} cycles with verdict ok on; here: {say_count(n_ok)}."
        ]
    found = list_drift(results) or ["No change was found that matters."]
    return [_say_reference(drift), *found, *_say_small(drift)]


def _say_reference(drift: Drift) -> str:
    index = drift.reference_cycle_index
    return (
        f"Each cycle with verdict ok is held against the first {say_count(len(index))}, up to cycle {index[-1]}, "
        f"which differ from each other by {say_mm(drift.usual_shape_distance_mm)}{NBSP}mm."
    )


def _say_small(drift: Drift) -> list[str]:
    n = sum(not change.matters for change in drift.changes)
    n += sum(trend.stands_out and not trend.matters for trend in drift.trends)
    if not n:
        return []
    subject = f"{n} smaller changes stand" if n > 1 else "One smaller change stands"
    return [f"{subject} out of the noise too: see drift.parquet and summary.json."]


def _say_change(change: DriftChange) -> str:
    what = "shape" if change.quantity == "shape" else "largest curvature"
    return f"The cable's {what} changed with cycle{NBSP}{change.cycle_index}: {_say_size(change)}{_say_where(change)}."


def _say_size(change: DriftChange) -> str:
    if change.quantity == "shape":
        direction = "away from" if change.size > 0 else "back towards"
        return (
            f"by {say_mm(abs(change.size))} ± {say_mm(2 * change.sigma)}{NBSP}mm {direction} that of the first cycles"
        )
    sign = "+" if change.size > 0 else ""
    return f"by {sign}{say_number(change.size, 2)} ± {say_number(2 * change.sigma, 2)}{NBSP}1/m"


def _say_where(change: DriftChange) -> str:
    if np.isnan(change.arc_length_m):
        return ""
    place = f"{say_number(1e3 * change.arc_length_m, 0)}{NBSP}mm from the anchor, phase{NBSP}{change.cycle_phase:.2f}"
    if change.quantity == "shape":
        return f"; most at the marker {place}, by {say_mm(change.largest)}{NBSP}mm"
    sign = "+" if change.largest > 0 else ""
    return f"; most at {place}, by {sign}{say_number(change.largest, 2)}{NBSP}1/m"


def _say_trend(trend: DriftTrend) -> str:
    slope, sigma = trend.per_1000_cycles, trend.sigma_per_1000_cycles
    if trend.quantity == "shape":
        direction = "away from" if slope > 0 else "back towards"
        return (
            f"The cable's shape drifts {direction} that of the first cycles, by {say_mm(abs(slope))} ± "
            f"{say_mm(2 * sigma)}{NBSP}mm in 1000 cycles."
        )
    sign = "+" if slope > 0 else ""
    return (
        f"The cable's largest curvature drifts by {sign}{say_number(slope, 2)} ± {say_number(2 * sigma, 2)}{NBSP}1/m "
        "in 1000 cycles."
    )
