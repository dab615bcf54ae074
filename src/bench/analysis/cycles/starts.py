"""When the robot really began to move: a register or an output tells it early or late, the joints do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.analysis.arrays import Bools, Floats, Ints
from bench.analysis.cycles.sources import REST_RAD_S
from bench.analysis.cycles.table import CycleTable

__all__ = ["refine_starts"]

WINDOW_NS = 1_000_000_000
"""A motion that is further from the shown start belongs to something else: a dwell in the cycle, another move."""
STANDSTILL_RAD_S = 1e-5
"""Speeds below this are rounding: a joint that starts at 1 rad/s² passes it in 10 µs."""
NOISE_RATIO = 3.0
"""Above this times the median of its own noise at rest, the fastest of six joints moves (4.7 sd of each of them)."""


def refine_starts(table: CycleTable, host_ns: Ints, speed_rad_s: Floats) -> tuple[CycleTable, Bools]:
    """Move each start to the last sample before the joints' speed leaves zero.

    A controller begins a motion on one of its own ticks, so that is the true start to one sample, if noise at rest is
    small: with noise n the speed must exceed 3 n, which a joint that starts with 1 rad/s² does 3 ms late for
    n = 1 mrad/s.

    Parameters
    ----------
    table : CycleTable
        The cycles as they were shown.
    host_ns : (n,)
        Times of the robot's samples, ascending.
    speed_rad_s : (n,)
        Speed of the fastest joint, NaN where unknown.

    Returns
    -------
    table : CycleTable
        With the starts that could be refined; never before the end of the cycle before.
    refined : (C,) bool
        Which they are. The others keep the shown start: the robot was not at rest there, or did not move within 1 s.
    """
    start_ns, refined = table.start_ns.copy(), np.zeros(len(table.start_ns), dtype=bool)
    earliest = np.concatenate([host_ns[:1], table.end_ns[:-1]])
    low = np.searchsorted(host_ns, np.maximum(start_ns - WINDOW_NS, earliest[: len(start_ns)]))
    at = np.searchsorted(host_ns, start_ns)
    high = np.searchsorted(host_ns, np.minimum(start_ns + WINDOW_NS, table.end_ns))
    for row in np.flatnonzero(table.seen & (low <= at) & (at < high)):
        last = _find_last_still(speed_rad_s[low[row] : high[row]], int(at[row] - low[row]))
        if last >= 0:
            start_ns[row], refined[row] = host_ns[low[row] + last], True
    return replace(table, start_ns=start_ns), refined


def _find_last_still(speed: Floats, at: int) -> int:
    """Return the last sample at rest before the motion that is nearest to sample `at`, -1 if there is none."""
    waiting = speed[: at + 1]
    resting = waiting[waiting <= REST_RAD_S]
    if not len(resting):
        return -1
    still = speed <= max(STANDSTILL_RAD_S, NOISE_RATIO * float(np.median(resting)))
    if still[at]:
        moving = np.flatnonzero(~still[at:])
        return at + int(moving[0]) - 1 if len(moving) else -1
    before = np.flatnonzero(still[:at])
    return int(before[-1]) if len(before) else -1
