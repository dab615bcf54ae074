"""Cycles from the robot's own counter, and each frame's place in its cycle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Ints
from bench.analysis.cycles.sources import RUNTIME_STOPPED

__all__ = ["CounterColumns", "CycleTable", "find_cycles", "whole_take"]

TAIL_SAMPLES = 5
"""A program writes its counter and its running mark in two controller steps, so that the mark may outlive the count.

5 samples are 10 ms at 500 Hz; no path is that short.
"""


@dataclass(frozen=True, eq=False)
class CounterColumns:
    """What the robot says about its cycles: n samples in order of capture."""

    host_ns: Ints
    count: Ints
    """Cycles completed since the program started, -1 where unknown."""
    running: Ints
    """1 on the path, 0 waiting."""
    phase: Floats
    """Place on the path, NaN where the program does not write it."""
    runtime_state: Ints
    """UR runtime state, -1 where unknown."""


@dataclass(frozen=True, eq=False)
class CycleTable:
    """One row for each of C cycles, in order of time; they do not overlap."""

    cycle_index: Ints
    start_ns: Ints
    end_ns: Ints
    complete: Bools
    """Whether the robot counted the cycle as completed."""
    unbroken: Bools
    """Whether the path was driven in one go."""
    seen: Bools
    """Whether the recording shows the beginning."""

    @property
    def duration_s(self) -> Floats:
        """Duration of each cycle."""
        return np.asarray((self.end_ns - self.start_ns) * 1e-9, dtype=np.float64)

    @property
    def usual_duration_s(self) -> float:
        """Median duration of the completed cycles, of all if none was completed; NaN without a cycle."""
        chosen = self.duration_s[self.complete] if self.complete.any() else self.duration_s
        return float(np.median(chosen)) if len(chosen) else float("nan")

    def take(self, rows: Bools) -> CycleTable:
        """Return the table of some of its rows (C,)."""
        return CycleTable(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def locate(self, host_ns: Ints) -> Ints:
        """Return the row of the cycle that holds each moment, -1 outside any: start <= moment < end."""
        row = np.searchsorted(self.start_ns, host_ns, side="right") - 1
        if len(self.start_ns) == 0:
            return row
        return np.where((row >= 0) & (host_ns < self.end_ns[np.maximum(row, 0)]), row, -1)


def whole_take(start_ns: int, end_ns: int) -> CycleTable:
    """Return the table of a take without cycles: all of it is cycle 0, its last moment included."""
    yes = np.ones(1, dtype=bool)
    return CycleTable(np.zeros(1, np.int64), np.array([start_ns]), np.array([end_ns + 1]), yes, yes, yes)


def find_cycles(robot: CounterColumns) -> CycleTable:
    """Find the cycles in the robot's counter and running mark.

    Cycle c runs from the first sample on the path with count c to the first sample with a larger count, each to one
    sample. A counter that jumps by more than one while nothing was received gives every cycle in between a row of its
    own, with times shared out over the gap. A counter that goes back starts a new block, which is numbered on from
    the last; what stood in the registers before that, with no cycle completed, is left over from an earlier program.
    """
    known = np.flatnonzero(robot.count >= 0)
    host, count = robot.host_ns[known], robot.count[known]
    on_path = robot.running[known] != 0
    on_path &= ~np.isin(robot.runtime_state[known], RUNTIME_STOPPED)
    bounds = np.flatnonzero(np.diff(count, prepend=count[:1]) < 0)
    tables: list[CycleTable] = []
    next_index = 0
    for low, high in zip([0, *bounds], [*bounds, len(known)], strict=True):
        if high == low:
            continue
        first_index = next_index - int(count[low]) if tables else 0
        table = _find_in_block(host, count, on_path, int(low), int(high), first_index)
        if len(table.cycle_index) and (high == len(known) or table.complete.any()):
            tables.append(table)
            next_index = int(table.cycle_index[-1]) + 1
    return _concatenate(tables)


def _find_in_block(host: Ints, count: Ints, on_path: Bools, low: int, high: int, first_index: int) -> CycleTable:
    """Find the cycles between two resets, samples [low, high): there the counter never goes back."""
    block = count[low:high]
    values = np.arange(block[0], block[-1] + 1)
    begin, end = low + np.searchsorted(block, values, "left"), low + np.searchsorted(block, values, "right")
    first, stop, which = _stretches_on_path(count, on_path, low, high, begin, end)
    n_stretches = np.bincount(which, minlength=len(values))
    has, complete = n_stretches > 0, end < high
    kept = has | complete
    at_first = np.searchsorted(which, np.flatnonzero(has), "left")
    at_last = np.searchsorted(which, np.flatnonzero(has), "right") - 1
    started, finished = _share_out_jumps(host, count, values, end, complete)
    start_index = first[at_first]
    started[has] = host[start_index]
    left_path = host[np.minimum(stop[at_last], len(host) - 1)]
    finished[has] = np.where(complete[has], finished[has], left_path)
    seen = np.zeros(len(values), dtype=bool)
    seen[has] = start_index > 0
    return CycleTable(
        (first_index + values)[kept],
        started[kept],
        finished[kept],
        complete[kept],
        (n_stretches <= 1)[kept],
        seen[kept],
    )


def _stretches_on_path(
    count: Ints, on_path: Bools, low: int, high: int, begin: Ints, end: Ints
) -> tuple[Ints, Ints, Ints]:
    """Return first sample, stop and place in `begin` of each stretch on the path with one count, without tails."""
    key = count[low:high] * 2 + on_path[low:high]
    first = low + np.flatnonzero(np.diff(key, prepend=key[0] - 1))
    stop = np.append(first[1:], high)
    chosen = on_path[first]
    first, stop = first[chosen], stop[chosen]
    which = count[first] - count[low]
    tail = (first == begin[which]) & (which > 0) & (stop - first <= TAIL_SAMPLES)
    tail &= (stop < end[which]) | (stop == high)
    return first[~tail], stop[~tail], which[~tail]


def _share_out_jumps(host: Ints, count: Ints, values: Ints, end: Ints, complete: Bools) -> tuple[Ints, Ints]:
    """Return the latest possible start and the end of each completed cycle; a jump shares its time out evenly."""
    after = np.where(complete, end, len(host) - 1)
    before = np.maximum(after - 1, 0)
    gap = host[after] - host[before]
    jump = np.maximum(count[after] - count[before], 1)
    place = np.clip(values - count[before], 0, jump - 1)
    return host[before] + gap * place // jump, host[before] + gap * (place + 1) // jump


def _concatenate(tables: list[CycleTable]) -> CycleTable:
    if not tables:
        none, no = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
        return CycleTable(none, none, none, no, no, no)
    names = ("cycle_index", "start_ns", "end_ns", "complete", "unbroken", "seen")
    return CycleTable(*(np.concatenate([getattr(table, name) for table in tables]) for name in names))
