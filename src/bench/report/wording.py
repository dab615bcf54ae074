"""Numbers and findings in words, as the page and the command line say them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

import numpy as np

from bench.model import Outcome
from bench.report.headline import Headline, TightestBend
from bench.report.results import ClockFinding, Results

__all__ = [
    "describe_clocks",
    "describe_cycles",
    "describe_ending",
    "describe_interval",
    "describe_losses",
    "describe_outcome",
    "describe_place",
    "find_worst_residual_us",
    "say_count",
    "say_mm",
    "say_number",
    "say_percent",
    "say_utc",
]

UNKNOWN = "–"
"""Stands where a number is missing."""
THIN = "\u202f"
"""A narrow space that does not break: groups thousands without the comma that means a decimal elsewhere."""
NBSP = "\u00a0"
"""A space that does not break."""
MINUS = "\u2212"
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def say_number(value: float, digits: int = 3) -> str:
    """Return `value` with `digits` after the point, thousands grouped; a dash for NaN."""
    if np.isnan(value):
        return UNKNOWN
    if np.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    return f"{value:,.{digits}f}".replace(",", THIN).replace("-", MINUS)


def say_mm(value_mm: float) -> str:
    """Return a length in millimetres with about four figures, without the unit."""
    return say_number(value_mm, 2 if abs(value_mm) < 10 else 1 if abs(value_mm) < 1000 else 0)


def say_count(value: int) -> str:
    """Return a count, thousands grouped."""
    return say_number(float(value), 0)


def say_percent(fraction: float) -> str:
    """Return a fraction as per cent, rounded so that only what is whole reads 100."""
    if np.isnan(fraction):
        return UNKNOWN
    return f"{np.floor(fraction * 1000) / 10:.1f}{THIN}%"


def say_utc(time_ns: int) -> str:
    """Return a Unix time in nanoseconds as date and time, UTC, to the millisecond; a dash if it is none."""
    if time_ns <= 0:
        return UNKNOWN
    moment = EPOCH + timedelta(microseconds=time_ns // 1000)
    return f"{moment:%Y-%m-%d %H:%M:%S}.{moment.microsecond // 1000:03d}"


def describe_outcome(results: Results, headline: Headline) -> list[str]:
    """Return what the outcome means, then its reasons, one sentence each."""
    limit = f"its catalogue limit of {headline.limit_mm:g} mm"
    crossed = headline.tightest is not None and headline.tightest.radius_mm < headline.limit_mm
    meaning = {
        Outcome.PASS: "The bench found nothing against the cable in this run.",
        Outcome.FAIL: f"The cable was bent tighter than {limit}." if crossed else "The cable did not pass.",
        Outcome.ERROR: "The bench was at fault. This is no verdict on the cable.",
    }[results.outcome]
    if results.outcome is Outcome.PASS and headline.tightest is not None and not crossed:
        meaning = f"No bend tighter than {limit} was measured."
    return [meaning, *results.outcome_reasons]


def describe_ending(results: Results) -> str:
    """Return how the run ended, with its reason."""
    how = {
        "success": "The run ended as planned",
        "abort": "The run was aborted",
        "fail": "The run failed",
        "unfinished": "The recording was never finished",
        "import": "Imported take",
    }.get(results.exit_status, f"The run ended with status {results.exit_status}")
    return f"{how}: {results.exit_reason.rstrip('.')}." if results.exit_reason else f"{how}."


def describe_cycles(headline: Headline) -> str:
    """Return how many cycles there are, and how many of them need no look."""
    if not headline.n_cycles:
        return "no cycle was completed"
    if headline.n_ok == headline.n_cycles:
        return "all ok" if headline.n_cycles > 1 else "ok"
    return f"{say_count(headline.n_ok)} ok, {say_count(headline.n_cycles - headline.n_ok)} not"


def describe_interval(bend: TightestBend) -> str:
    """Return the interval of two standard deviations around a bend radius."""
    if np.isnan(bend.low_mm) or np.isnan(bend.high_mm):
        return "uncertainty not known"
    if np.isinf(bend.high_mm):
        return f"{say_mm(bend.low_mm)}{NBSP}mm or more (± 2 sd reaches a straight cable)"
    return f"{say_mm(bend.low_mm)} to {say_mm(bend.high_mm)}{NBSP}mm (± 2{NBSP}sd)"


def describe_place(bend: TightestBend) -> str:
    """Return where along the cable and when the tightest bend was."""
    parts = [f"cycle{NBSP}{bend.cycle_index}"]
    if np.isfinite(bend.cycle_phase):
        parts.append(f"phase{NBSP}{bend.cycle_phase:.3f}")
    if np.isfinite(bend.arc_length_mm):
        parts.insert(0, f"{say_mm(bend.arc_length_mm)}{NBSP}mm from the anchor")
    return ", ".join(parts)


def describe_losses(headline: Headline) -> str:
    """Return in one line what was lost."""
    written = f"{say_count(headline.n_recorded)} records written"
    if not headline.n_recorded and not headline.n_dropped and not headline.n_missed:
        return "no stream is counted in this recording"
    if not headline.n_dropped and not headline.n_missed:
        return f"nothing dropped, nothing missed; {written}"
    dropped = f"{say_count(headline.n_dropped)} dropped by the bench"
    missed = f"{say_count(headline.n_missed)} never came from a device"
    return f"{dropped}, {missed}; {written}"


def describe_clocks(clocks: Sequence[ClockFinding]) -> list[str]:
    """Return how each device's clock ran against ours, one line for each device."""
    if not clocks:
        return ["no device clock: times are the recording's own"]
    devices = dict.fromkeys(clock.device for clock in clocks)
    return [_one_clock(device, [clock for clock in clocks if clock.device == device]) for device in devices]


def _one_clock(device: str, segments: Sequence[ClockFinding]) -> str:
    worst = find_worst_residual_us(segments)
    residual = "residual not known" if np.isnan(worst) else f"residual {say_number(worst, 0)} µs"
    if len(segments) > 1:
        return f"{device}: {len(segments)} segments, {residual} at most"
    drift = segments[0].drift_ppm
    if np.isnan(drift):
        return f"{device}: {residual}"
    return f"{device}: {'+' if drift > 0 else ''}{say_number(drift, 1)} ppm, {residual}"


def find_worst_residual_us(clocks: Sequence[ClockFinding]) -> float:
    """Return the largest residual of any clock, NaN when none is known."""
    return max((clock.residual_sd_us for clock in clocks if np.isfinite(clock.residual_sd_us)), default=float("nan"))
