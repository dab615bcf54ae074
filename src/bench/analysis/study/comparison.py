"""How far two motions of a cable are apart: eq. (6) of the paper, over cycle phase and arc length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats, Floats32, Ints
from bench.analysis.calibration.rigid import RigidTransform, kabsch
from bench.analysis.curvature.spline import interpolate_curve
from bench.errors import AnalysisError

__all__ = [
    "MotionDifference",
    "align_in_space",
    "align_in_time",
    "compare_motions",
    "draw_motion",
    "median_cycle",
    "shift_motion",
]

MOST_CYCLES = 200
"""Cycles spread over a run whose median is taken: it has 9 % of the noise of a frame; more would take time alone."""
LONGEST_STEP = 2.5
"""Frames further apart than this many usual steps are not joined: the cable was not seen between them."""
TINY_PHASE = 1e-12
"""Frames of one phase, while the robot rests, are no further apart than this."""
SEARCH_STRIDE = 10
"""Of the places along the cable, every tenth serves while the offset in time is looked for."""
NOTHING_IN_COMMON = "The two motions have no phase and no place on the cable in common: nothing is compared."
LEAST_OVERLAP = 0.5
"""Of a motion that does not repeat, what must remain when it is shifted against another."""


@dataclass(frozen=True, eq=False)
class MotionDifference:
    """Two motions at the same P phases and G arc lengths, and the figures of eq. (6)."""

    difference_m: Floats
    """(P, G, 3): first minus second; NaN where one of both is unknown."""
    coordinate_m: Floats
    """(3,): root mean square of each coordinate of the difference."""
    compared: float
    """Share of phases and arc lengths at which both are known."""

    @property
    def distance_m(self) -> Floats:
        """(P, G): distance of the same place of the cable in both motions."""
        return np.asarray(np.linalg.norm(self.difference_m, axis=2))

    @property
    def e2_m2(self) -> float:
        """e^2 of eq. (6): mean square of the distance over arc length and cycle, m^2."""
        return float(np.sum(self.coordinate_m**2))

    @property
    def e_m(self) -> float:
        """Its root."""
        return float(np.sqrt(self.e2_m2))


def median_cycle(
    position_m: Floats32, cycle: Ints, phase: Floats, time_ns: Ints, trusted: Bools, phase_grid: Floats
) -> Floats:
    """Return the motion of the usual cycle: the median over the cycles at each phase.

    Each cycle is interpolated linearly between its frames to the same phases; so it does not matter that the frames
    of two runs were taken at other moments.

    Parameters
    ----------
    position_m : (F, k, 3)
        Sorted markers, NaN where not found.
    cycle : (F,)
        Each frame's cycle; -1 outside any.
    phase : (F,)
        0…1
    time_ns : (F,)
        Capture times: over a gap nothing is interpolated.
    trusted : (F,)
        Frames that may be used.
    phase_grid : (P,)
        Ascending.

    Returns
    -------
    (P, k, 3)
        NaN where no cycle has a frame on both sides.
    """
    usable = np.flatnonzero(trusted & (cycle >= 0) & np.isfinite(phase))
    order = usable[np.lexsort((phase[usable], cycle[usable]))]
    firsts = np.flatnonzero(np.diff(cycle[order], prepend=-1))
    chosen = np.unique(np.linspace(0, len(firsts) - 1, min(MOST_CYCLES, len(firsts))).astype(np.int64))
    bounds = np.append(firsts, len(order))
    shape = (len(phase_grid), *position_m.shape[1:])
    longest_ns = LONGEST_STEP * float(np.median(np.diff(np.sort(time_ns)))) if len(time_ns) > 1 else 0.0
    cycles = []
    for i in chosen:
        frames = order[bounds[i] : bounds[i + 1]]
        cycles.append(_at_phases(position_m[frames], phase[frames], time_ns[frames], phase_grid, longest_ns))
    return _median(np.array(cycles).reshape(-1, *shape))


def _at_phases(position_m: Floats32, phase: Floats, time_ns: Ints, phase_grid: Floats, longest_ns: float) -> Floats:
    """Interpolate one cycle's frames, in order of phase."""
    result = np.full((len(phase_grid), *position_m.shape[1:]), np.nan)
    if len(phase) < 2:
        return result
    right = np.searchsorted(phase, phase_grid)
    inside = (right > 0) & (right < len(phase))
    inside[inside] = np.abs(time_ns[right[inside]] - time_ns[right[inside] - 1]) <= longest_ns
    left, right = right[inside] - 1, right[inside]
    share = (phase_grid[inside] - phase[left]) / np.maximum(phase[right] - phase[left], TINY_PHASE)
    result[inside] = position_m[left] + share[:, None, None] * (position_m[right] - position_m[left])
    return result


def _median(cycles: Floats) -> Floats:
    """Return the median over the first axis, without NaNs; NaN where nothing else is."""
    result = np.full(cycles.shape[1:], np.nan)
    seen = np.isfinite(cycles).any(axis=0)
    if seen.any():
        result[seen] = np.nanmedian(cycles[:, seen], axis=0)
    return result


def draw_motion(position_m: Floats, marker_arc_length_m: Floats, arc_length_m: Floats) -> Floats:
    """Return the cable (P, G, 3) at `arc_length_m` (G,): the spline through the markers (P, k, 3) of each phase."""
    curves = [
        interpolate_curve(markers.astype(np.float32), marker_arc_length_m, arc_length_m) for markers in position_m
    ]
    return np.array(curves).reshape(len(position_m), len(arc_length_m), 3)


def compare_motions(first_m: Floats, second_m: Floats, arc_length_m: Floats) -> MotionDifference:
    """Compare two motions (P, G, 3) by eq. (6): e^2 = 1 / (L T) times the integral of (x1 - x2)^2 over length and time.

    Every phase counts alike, and every stretch of cable (by the trapezoidal rule) over which both are known.

    Raises
    ------
    AnalysisError
        There is no place at which both are known.
    """
    difference = first_m - second_m
    known = np.isfinite(difference).all(axis=2)
    if not known.any():
        raise AnalysisError(NOTHING_IN_COMMON)
    steps = np.diff(arc_length_m)
    weight = known * (np.append(steps, 0.0) + np.append(0.0, steps)) / 2
    square = np.nansum(weight[:, :, None] * difference**2, axis=(0, 1)) / weight.sum()
    return MotionDifference(difference, np.sqrt(square), float(known.mean()))


def align_in_space(first_m: Floats, second_m: Floats) -> RigidTransform:
    """Return the one rigid transform, for all phases, that lays the second motion (P, G, 3) onto the first.

    The one that makes e of eq. (6) smallest.
    """
    known = np.isfinite(first_m).all(axis=2) & np.isfinite(second_m).all(axis=2)
    if not known.any():
        raise AnalysisError(NOTHING_IN_COMMON)
    return kabsch(second_m[known], first_m[known], np.ones(int(known.sum())))


def align_in_time(first_m: Floats, second_m: Floats, *, repeats: bool, in_space: bool = False) -> float:
    """Return by which share of a cycle the second motion (P, G, 3) is late, to within half a cycle.

    The shift that makes e of eq. (6) smallest: first over whole phase steps, then between them.

    Parameters
    ----------
    first_m, second_m : (P, G, 3)
        At P phases evenly spaced over the cycle.
    repeats : bool
        Whether a cycle ends where the next begins; otherwise what is shifted beyond the motion is not compared.
    in_space : bool
        Whether the motions may be laid onto each other for each shift, their spaces being different.
    """
    one, other = first_m[:, ::SEARCH_STRIDE], second_m[:, ::SEARCH_STRIDE]
    n_phases = len(one)

    def misfit(shift: float) -> float:
        return _misfit(one, shift_motion(other, shift, repeats=repeats), in_space=in_space)

    steps = np.arange(-(n_phases // 2), n_phases // 2 + 1) / n_phases
    best = float(min(steps, key=lambda shift: (misfit(shift), abs(shift))))
    found = scipy.optimize.minimize_scalar(misfit, bounds=(best - 1 / n_phases, best + 1 / n_phases), method="bounded")
    return float(found.x) if found.fun < misfit(best) else best


def _misfit(first_m: Floats, second_m: Floats, *, in_space: bool) -> float:
    known = np.isfinite(first_m).all(axis=2) & np.isfinite(second_m).all(axis=2)
    if known.mean() < LEAST_OVERLAP * np.isfinite(first_m).all(axis=2).mean() or not known.any():
        return np.inf
    one, other = first_m[known], second_m[known]
    if in_space:
        other = kabsch(other, one, np.ones(len(one))).apply(other)
    return float(np.mean(np.square(one - other).sum(axis=1)))


def shift_motion(motion_m: Floats, shift: float, *, repeats: bool) -> Floats:
    """Return the motion (P, G, 3) at phases `shift` later, linearly between the known ones."""
    n_phases = len(motion_m)
    wanted = np.arange(n_phases) + shift * n_phases
    left = np.floor(wanted).astype(np.int64)
    share = (wanted - left)[:, None, None]
    shifted = (1 - share) * motion_m[left % n_phases] + share * motion_m[(left + 1) % n_phases]
    if not repeats:
        shifted[(left < 0) | (wanted > n_phases - 1)] = np.nan
    return np.asarray(shifted)
