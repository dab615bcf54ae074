"""Numbers and findings in words, as the page and the command line say them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta

import numpy as np

from bench.model import Outcome
from bench.report.headline import Headline, TightestBend
from bench.report.results import ClockFinding, Results

__all__ = [
    "RECORDED",
    "count_decimals",
    "describe_clocks",
    "describe_cycles",
    "describe_ending",
    "describe_interval",
    "describe_losses",
    "describe_outcome",
    "describe_place",
    "describe_seen",
    "find_worst_residual_us",
    "say_count",
    "say_mm",
    "say_number",
    "say_percent",
    "say_radius",
    "say_range",
    "say_short_time",
    "say_utc",
    "say_versions",
]

UNKNOWN = "–"
"""Stands where a number is missing."""
THIN = "\u202f"
"""A narrow space that does not break: groups thousands without the comma that means a decimal elsewhere."""
NBSP = "\u00a0"
"""A space that does not break."""
MINUS = "\u2212"
GROUPED_FROM = 10_000
"""Four digits are read at a glance; from five on they are grouped."""
RECORDED = "recorded with "
"""How the name of a version begins that a recording tells of itself."""
UNDECIDED = "The limit lies inside the interval of the smallest bend radius: by noise alone it may be on either side."
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def say_number(value: float, digits: int = 3) -> str:
    """Return `value` with `digits` after the point, thousands grouped; a dash for NaN."""
    if np.isnan(value):
        return UNKNOWN
    if np.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    grouped = f"{value:,.{digits}f}" if abs(value) >= GROUPED_FROM else f"{value:.{digits}f}"
    return grouped.replace(",", THIN).replace("-", MINUS)


def say_mm(value_mm: float) -> str:
    """Return a length in millimetres with about four figures, without the unit."""
    return say_number(value_mm, 2 if abs(value_mm) < 10 else 1 if abs(value_mm) < 1000 else 0)


def count_decimals(spread: float) -> int:
    """Return how many decimals a value has whose interval reaches `spread` to one side, 2 at most.

    The last figure is a third of the interval or finer, and not finer than a thirtieth: more figures would claim to
    know what the interval says is not known.
    """
    if not np.isfinite(spread) or spread <= 0:
        return 1
    return int(np.clip(-np.floor(np.log10(spread / 3)), 0, 2))


def say_radius(radius_mm: float, low_mm: float) -> str:
    """Return a bend radius with the decimals that the lower end of its interval leaves it, without the unit."""
    return say_number(radius_mm, count_decimals(radius_mm - low_mm)) if np.isfinite(low_mm) else say_mm(radius_mm)


def say_range(radius_mm: float, low_mm: float, high_mm: float) -> str:
    """Return the interval of a bend radius with the decimals of the radius, without the unit."""
    digits = count_decimals(radius_mm - low_mm)
    return f"{say_number(low_mm, digits)} to {say_number(high_mm, digits)}"


def say_short_time(time_us: float) -> str:
    """Return a time given in microseconds with its unit: two figures where it is a millisecond or more."""
    if np.isnan(time_us):
        return UNKNOWN
    if time_us < 1000:
        return f"{say_number(time_us, 0)}{NBSP}µs"
    return f"{say_number(time_us / 1000, 1 if time_us < 10_000 else 0)}{NBSP}ms"


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


def say_versions(versions: Mapping[str, str]) -> str:
    """Return in one line the versions that recorded, then those that analysed."""
    recorded = [f"{name.removeprefix(RECORDED)} {text}" for name, text in versions.items() if name.startswith(RECORDED)]
    analysed = [f"{name} {text}" for name, text in versions.items() if not name.startswith(RECORDED)]
    parts = [f"recorded with {', '.join(recorded)}"] if recorded else []
    return "; ".join([*parts, f"analysed with {', '.join(analysed)}"])


def describe_outcome(results: Results, headline: Headline) -> list[str]:
    """Return what the outcome means, then its reasons, one sentence each."""
    limit = f"its catalogue limit of {headline.limit_mm:g} mm"
    crossed = headline.tightest is not None and headline.tightest.radius_mm < headline.limit_mm
    meaning = {
        Outcome.PASS: "The bench found nothing against the cable in this run.",
        Outcome.FAIL: f"The cable was bent tighter than {limit}." if crossed else "The cable did not pass.",
        Outcome.ERROR: "This is no verdict on the cable: the bench, or what it recorded, was at fault.",
    }[results.outcome]
    if results.outcome is Outcome.PASS and headline.tightest is not None and not crossed:
        meaning = f"No bend tighter than {limit} was measured."
    return [meaning, *results.outcome_reasons, *([UNDECIDED] if headline.limit_inside_interval else [])]


def describe_ending(results: Results) -> str:
    """Return how the run ended, with its reason."""
    reason = results.exit_reason.removeprefix("unfinished: ").rstrip(".")
    if results.exit_status == "import" and reason:
        return f"{reason[0].upper()}{reason[1:]}."
    how = {
        "success": "The run ended as planned",
        "abort": "The run was aborted",
        "fail": "The run failed",
        "unfinished": "The recording was never finished",
        "import": "Imported take",
    }.get(results.exit_status, f"The run ended with status {results.exit_status}")
    return f"{how}: {reason}." if reason else f"{how}."


def describe_cycles(headline: Headline, n_odd: int) -> str:
    """Return how many cycles there are, and how many of them need no look."""
    if not headline.n_cycles:
        return "no cycle was completed"
    if headline.n_ok == headline.n_cycles:
        well = "recorded whole" if n_odd else "ok"  # a cycle with verdict ok may need a look all the same
        return f"all {well}" if headline.n_cycles > 1 else well
    return f"{say_count(headline.n_ok)} ok, {say_count(headline.n_cycles - headline.n_ok)} not"


def describe_seen(results: Results) -> str:
    """Return in how much of the frames every marker was found, empty where there are no frames."""
    source = results.frames.source
    if not len(source):
        return ""
    fraction = float((source >= 0).all(axis=1).mean())
    return f"every marker found in {'all' if fraction == 1 else say_percent(fraction) + ' of the'} frames"


def describe_interval(bend: TightestBend) -> str:
    """Return the interval of two standard deviations around a bend radius."""
    if np.isnan(bend.low_mm) or np.isnan(bend.high_mm):
        return "uncertainty not known"
    if np.isinf(bend.high_mm):
        low = say_number(bend.low_mm, count_decimals(bend.radius_mm - bend.low_mm))
        return f"{low}{NBSP}mm or more (± 2 sd reaches a straight cable)"
    return f"{say_range(bend.radius_mm, bend.low_mm, bend.high_mm)}{NBSP}mm (± 2{NBSP}sd)"


def describe_place(bend: TightestBend) -> str:
    """Return where along the cable and when the tightest bend was."""
    parts = [f"cycle{NBSP}{bend.cycle_index}"]
    if np.isfinite(bend.cycle_phase):
        parts.append(f"phase{NBSP}{bend.cycle_phase:.2f}")
    if np.isfinite(bend.arc_length_mm):
        parts.insert(0, f"{say_number(bend.arc_length_mm, 0)}{NBSP}mm from the anchor")
    return ", ".join(parts)


def describe_losses(headline: Headline) -> str:
    """Return in one line what was lost."""
    written = f"{say_count(headline.n_recorded)} records written"
    if not headline.n_recorded and not headline.n_dropped and not headline.n_missed:
        return "no stream is counted in this recording"
    if not headline.n_dropped and not headline.n_missed:
        return f"nothing dropped, nothing missed; {written}"
    dropped = f"{say_count(headline.n_dropped)} dropped by the bench"
    missed = f"{say_count(headline.n_missed)} never came from the {' and the '.join(headline.missed_from)}"
    return f"{dropped}, {missed}; {written}"


def describe_clocks(clocks: Sequence[ClockFinding]) -> list[str]:
    """Return how each device's clock ran against ours, one line for each device."""
    if not clocks:
        return ["no device clock: times are the recording's own"]
    devices = dict.fromkeys(clock.device for clock in clocks)
    return [_one_clock(device, [clock for clock in clocks if clock.device == device]) for device in devices]


def _one_clock(device: str, segments: Sequence[ClockFinding]) -> str:
    worst = find_worst_residual_us(segments)
    residual = "residual not known" if np.isnan(worst) else f"residual {say_short_time(worst)}"
    if len(segments) > 1:
        return f"{device}: {len(segments)} segments, {residual} at most"
    drift = segments[0].drift_ppm
    if np.isnan(drift):
        return f"{device}: {residual}"
    return f"{device}: drift {'+' if drift > 0 else ''}{say_number(drift, 1)}{NBSP}ppm, {residual}"


def find_worst_residual_us(clocks: Sequence[ClockFinding]) -> float:
    """Return the largest residual of any clock, NaN when none is known."""
    return max((clock.residual_sd_us for clock in clocks if np.isfinite(clock.residual_sd_us)), default=float("nan"))
