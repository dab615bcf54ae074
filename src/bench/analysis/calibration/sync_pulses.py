"""One time by wire: a digital output of the robot switches a lamp that the cameras see as a marker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints
from bench.errors import AnalysisError

__all__ = ["PulseOffset", "SwitchTimes", "estimate_pulse_offset", "see_lamp"]

LAMP_RADIUS_M = 0.01
"""A lamp does not move: what is further from its place is something else."""
LARGEST_OFFSET_S = 0.25
"""Between the mapped clocks; pulses and pauses must last longer than twice this to be told apart."""
FEWEST_EDGES = 4
LEAST_AGREEMENT = 0.8
"""Share of the edges that must allow one offset: a lamp that something hides for a moment spoils single ones."""
CLOCKS_S = 50e-6
"""How well both clocks are mapped: the standard deviation that many edges cannot go below."""


@dataclass(frozen=True, eq=False)
class SwitchTimes:
    """Moments at which something was switched, each known to lie between two samples."""

    before_s: Floats
    """(m,): the last sample of the old state."""
    after_s: Floats
    """(m,): the first of the new one."""
    is_on: Bools
    """(m,): whether it was switched on."""

    @classmethod
    def find(cls, time_s: Floats, is_on: Bools) -> SwitchTimes:
        """Find them in samples (n,) in ascending order."""
        changes = np.flatnonzero(is_on[1:] != is_on[:-1])
        return cls(time_s[changes], time_s[changes + 1], is_on[changes + 1])


@dataclass(frozen=True)
class PulseOffset:
    """A constant between two clocks."""

    offset_s: float
    """To be added to the tracker's times so that they agree with the robot's."""
    sigma_s: float
    """Standard deviation: of a uniform distribution over what the edges allow, and of both clocks' maps."""
    n_edges: int
    n_agreeing: int


def see_lamp(points_m: Floats32, offsets: Ints, place_m: Floats) -> Bools:
    """Tell in which of F frames a point is where the lamp is.

    Parameters
    ----------
    points_m, offsets
        The point lists of F frames: (N, 3) in the lab frame and (F + 1,).
    place_m : (3,)
        The lamp's place in the lab frame, to 10 mm.
    """
    near = np.square(points_m - place_m).sum(axis=1) < LAMP_RADIUS_M**2
    counts = np.concatenate([[0], np.cumsum(near)])
    return np.asarray(counts[offsets[1:]] > counts[offsets[:-1]])


def estimate_pulse_offset(output: SwitchTimes, lamp: SwitchTimes) -> PulseOffset:
    """Find the offset that puts every edge of the lamp between the samples that show the output's edge.

    An edge alone says little: the lamp came on somewhere between two frames. Edges at moments unrelated to the frames
    cut the interval down, by about their number.

    Parameters
    ----------
    output : SwitchTimes
        Of the digital output, in the robot's mapped time.
    lamp : SwitchTimes
        Of the lamp, in the tracker's mapped time.

    Raises
    ------
    AnalysisError
        Too few edges, or edges that contradict each other.
    """
    low_s, high_s = _allowed(output, lamp)
    if len(low_s) < FEWEST_EDGES:
        raise AnalysisError(
            f"Only {len(low_s)} switchings of the sync lamp can be matched with its digital output; {FEWEST_EDGES} are "
            f"the least ({len(output.is_on)} of the output and {len(lamp.is_on)} of the lamp were recorded).",
            hint="Check [calibration] sync_output and sync_marker_m; let pulses and pauses last 0.6 s or longer.",
        )
    # Each edge allows an interval: the offset lies where most of them overlap.
    ends = np.concatenate([low_s, high_s])
    order = np.lexsort((np.repeat([1, 0], len(low_s)), ends))
    depth = np.cumsum(np.repeat([1, -1], len(low_s))[order])
    best = int(depth.argmax())
    start_s, end_s = float(ends[order[best]]), float(ends[order[best + 1]])
    if depth[best] < LEAST_AGREEMENT * len(low_s):
        raise AnalysisError(
            f"The switchings of the sync lamp contradict each other: {depth[best]} of {len(low_s)} allow one offset.",
            hint="Is something else at [calibration] sync_marker_m, or is the lamp hidden at times?",
        )
    sigma_s = float(np.hypot((end_s - start_s) / np.sqrt(12.0), CLOCKS_S))
    return PulseOffset((start_s + end_s) / 2, sigma_s, len(low_s), int(depth[best]))


def _allowed(output: SwitchTimes, lamp: SwitchTimes) -> tuple[Floats, Floats]:
    """Return the lowest and highest offset by each edge of the output that one edge of the lamp alone can belong to."""
    low_s, high_s = [], []
    for before_s, after_s, is_on in zip(output.before_s, output.after_s, output.is_on, strict=True):
        low, high = before_s - lamp.after_s, after_s - lamp.before_s
        possible = (lamp.is_on == is_on) & (low < LARGEST_OFFSET_S) & (high > -LARGEST_OFFSET_S)
        if possible.sum() == 1:
            low_s.append(float(low[possible][0]))
            high_s.append(float(high[possible][0]))
    return np.array(low_s), np.array(high_s)
