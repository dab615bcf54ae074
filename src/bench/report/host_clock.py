"""Whether the computer's UTC clock was moved during the run, from the pairs noted beside host time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.model import ClockSource
from bench.recording import CLOCK, Run

Ints = npt.NDArray[np.int64]

__all__ = ["describe_host_clock", "warn_of_steps"]

STEP_NS = 10_000_000
"""Between two pairs, 10 s apart, NTP slews by 5 ms at most (500 ppm)."""


def describe_host_clock(run: Run) -> str:
    """Return how far UTC went from host time during the run; empty where nothing was noted, or simulated time ran."""
    away_ns = _find_deviation(run)
    if len(away_ns) < 2:
        return ""
    spread_ms = float(np.ptp(away_ns)) * 1e-6
    return f"UTC moved against it by {spread_ms:.2f} ms at most, seen at {len(away_ns)} moments"


def warn_of_steps(run: Run) -> list[str]:
    """Return a sentence if UTC was set during the run."""
    steps = np.diff(_find_deviation(run))
    if not len(steps) or np.abs(steps).max() < STEP_NS:
        return []
    largest = float(steps[np.abs(steps).argmax()]) * 1e-9
    text = (
        f"The computer's clock was set during the run, by {largest:+.3f} s in one step at most. The times here go on "
        "evenly from its reading at the start of the run, so they are apart from UTC by that."
    )
    return [text]


def _find_deviation(run: Run) -> Ints:
    """Return UTC minus host time at each noted pair, ns; empty at another speed than real time."""
    samples = run[CLOCK]
    rows = np.flatnonzero(samples.source == ClockSource.HOST)
    if float(run.metadata.get("bench.run", {}).get("clock_speed", "1.0")) != 1.0:
        rows = rows[:0]
    middle = samples.send_ns[rows] + (samples.receive_ns[rows] - samples.send_ns[rows]) // 2
    return np.asarray(samples.device_ticks[rows] - middle, dtype=np.int64)
