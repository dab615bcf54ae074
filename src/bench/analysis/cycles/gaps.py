"""Gaps in a device's own sequence: what never came."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Ints

__all__ = ["Gaps", "find_gaps"]


@dataclass(frozen=True, eq=False)
class Gaps:
    """Places where records are missing from a stream."""

    start_ns: Ints
    """(g,): host time of the last record before each gap."""
    end_ns: Ints
    """(g,): host time of the first record after it."""
    n_missed: Ints
    """(g,): records missing by the sequence; 0 at a change of segment, where the sequence does not tell."""

    @property
    def total(self) -> int:
        """Records missing in all."""
        return int(self.n_missed.sum())

    def touch(self, start_ns: Ints, end_ns: Ints) -> Bools:
        """Return for each interval [start, end] whether a gap overlaps it."""
        begun = np.searchsorted(self.start_ns, end_ns, side="left")
        over = np.searchsorted(np.maximum.accumulate(self.end_ns), start_ns, side="right")
        return np.asarray(begun > over, dtype=bool)


def find_gaps(sequence: Ints, segment: Ints, host_ns: Ints) -> Gaps:
    """Find the gaps of a stream, in order of time.

    The usual step of the sequence is one record, whatever its size: a tracker that sends every second frame has
    frame numbers in steps of two.

    Parameters
    ----------
    sequence, segment, host_ns : (n,)
        The device's own count, its clock segment and the capture time of each record, in order of capture.
    """
    step = np.diff(sequence)
    same = np.diff(segment) == 0
    forward = step[same & (step > 0)]
    unit = max(1, int(np.median(forward))) if len(forward) else 1
    missed = np.where(same, np.rint(step / unit).astype(np.int64) - 1, 0)
    at = np.flatnonzero((missed > 0) | ~same)
    return Gaps(host_ns[at], host_ns[at + 1], missed[at])
