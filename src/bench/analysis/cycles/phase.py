"""Where in its cycle each frame was taken."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats, Ints
from bench.analysis.cycles.table import CounterColumns, CycleTable

__all__ = ["phase_from_register", "phase_from_time"]

SMALLEST_RANGE = 0.5
"""A phase register that covers less of 0…1 than this in the usual cycle is not one (a program that never writes it)."""


def phase_from_time(table: CycleTable, row: Ints, host_ns: Ints) -> Floats:
    """Return the part of its cycle's duration that has passed at each moment (F,), NaN outside any cycle.

    A cycle that was not completed is measured by the median duration of the others.
    """
    phase = np.full(len(host_ns), np.nan)
    inside = row >= 0
    duration = np.where(table.complete, table.duration_s, np.fmax(table.usual_duration_s, table.duration_s))
    elapsed = (host_ns[inside] - table.start_ns[row[inside]]) * 1e-9
    phase[inside] = np.clip(elapsed / np.maximum(duration[row[inside]], 1e-9), 0.0, 1.0)
    return phase


def phase_from_register(table: CycleTable, robot: CounterColumns, row: Ints, host_ns: Ints) -> Floats | None:
    """Return the program's own phase interpolated to each moment (F,), NaN outside any cycle.

    None if the program does not write a phase, or writes one that does not run from 0 to 1.

    Parameters
    ----------
    table : CycleTable
        The cycles.
    robot : CounterColumns
        The robot's samples, in order of capture.
    row : (F,)
        The cycle row of each moment, -1 outside.
    host_ns : (F,)
        The moments.
    """
    sample_row = table.locate(robot.host_ns)
    known = np.isfinite(robot.phase) & (sample_row >= 0)
    if not known.any() or _usual_range(sample_row[known], robot.phase[known]) < SMALLEST_RANGE:
        return None
    ends = np.flatnonzero(table.complete)
    knots = np.concatenate([robot.host_ns[known], table.end_ns[ends] - 1])
    values = np.concatenate([robot.phase[known], np.ones(len(ends))])
    order = np.argsort(knots, kind="stable")
    origin = knots[order[0]]
    phase = np.full(len(host_ns), np.nan)
    inside = row >= 0
    moments = (host_ns[inside] - origin).astype(np.float64)
    phase[inside] = np.interp(moments, (knots[order] - origin).astype(np.float64), values[order])
    return np.asarray(np.clip(phase, 0.0, 1.0), dtype=np.float64)


def _usual_range(row: Ints, phase: Floats) -> float:
    """Return the median over the cycles of the range their phase covers; `row` ascends."""
    first = np.flatnonzero(np.diff(row, prepend=-1))
    return float(np.median(np.maximum.reduceat(phase, first) - np.minimum.reduceat(phase, first)))
