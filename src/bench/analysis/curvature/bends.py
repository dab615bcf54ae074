"""From curvature in every frame to the figures of a cycle and of a place on the path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints, chunks
from bench.analysis.curvature.local_average import average_peaks, choose_width, estimate_noise_variance

__all__ = ["TRUSTED_CONFIDENCE", "CycleBends", "find_peaks", "find_tighter", "summarise_cycles"]

TRUSTED_CONFIDENCE = 0.75
"""Frames below this confidence do not enter a cycle's figures: a quarter of their markers is missing or doubtful."""


@dataclass(frozen=True, eq=False)
class CycleBends:
    """The bending of each of C cycles; NaN where no trusted frame has a curve."""

    n_frames: Ints
    complete_fraction: Floats
    """Part of the frames in which every marker was found."""
    max_curvature_per_m: Floats
    """Largest curvature of any trusted frame, averaged with its neighbours in time, at any place."""
    max_curvature_sigma_per_m: Floats
    """Its standard deviation."""
    max_curvature_arc_length_m: Floats
    """Its place."""
    mean_curvature_per_m: Floats
    """Mean over trusted frames and the places where they have a curve."""
    n_averaged: int
    """Frames of which the largest curvatures are averages, at most; 1: single frames."""


def summarise_cycles(
    row: Ints,
    n_cycles: int,
    complete: Bools,
    trusted: Bools,
    curvature_per_m: Floats32,
    sigma_per_m: Floats32,
    arc_length_m: Floats,
) -> CycleBends:
    """Gather the frames of each cycle.

    The largest of many noisy values lies above the truth. So frames are averaged with their neighbours in time first,
    as many as the noise deserves and the motion allows: chosen once for all cycles, by the least risk about their
    maxima. Where frames are few or bends quick that is the single frame. The standard deviation is what is left of the
    noise from frame to frame, the rest of the stated one, which no average reduces, and what the average may have taken
    off the maximum.

    Parameters
    ----------
    row : (F,)
        Each frame's cycle, 0 to C - 1, -1 outside any; frames in order of time.
    n_cycles : int
        C.
    complete, trusted : (F,)
        Frames with every marker found; frames that may enter the curvature.
    curvature_per_m, sigma_per_m : (F, G)
        NaN where there is no curve.
    arc_length_m : (G,)
        Places.
    """
    inside = row >= 0
    n_frames = np.bincount(row[inside], minlength=n_cycles)
    n_complete = np.bincount(row[inside & complete], minlength=n_cycles)
    total, count = _sum_frames(curvature_per_m)
    used = inside & trusted & (count > 0)
    sums = np.bincount(row[used], total[used], minlength=n_cycles)
    counts = np.bincount(row[used], count[used], minlength=n_cycles)
    largest = _find_largest(row, n_cycles, used, curvature_per_m, sigma_per_m)
    columns = np.full((3, n_cycles), np.nan)
    columns[:, largest.cycle] = largest.curvature_per_m, largest.sigma_per_m, arc_length_m[largest.place]
    with np.errstate(invalid="ignore"):
        return CycleBends(
            n_frames, n_complete / n_frames, columns[0], columns[1], columns[2], sums / counts, largest.n_averaged
        )


@dataclass(frozen=True, eq=False)
class _Largest:
    """The largest bends of the M cycles that have one."""

    cycle: Ints
    place: Ints
    curvature_per_m: Floats
    sigma_per_m: Floats
    n_averaged: int


def _find_largest(row: Ints, n_cycles: int, used: Bools, curvature_per_m: Floats32, sigma_per_m: Floats32) -> _Largest:
    peak, place = find_peaks(curvature_per_m)
    cycle, frame = _largest_by_cycle(row, np.where(used, peak, np.nan), n_cycles)
    own = sigma_per_m[frame, place[frame]].astype(np.float64)
    variance = estimate_noise_variance(curvature_per_m, sigma_per_m, row, used)
    average = choose_width(curvature_per_m, variance, row, used, frame, place[frame])
    if average.half_width == 0:
        return _Largest(cycle, place[frame], peak[frame], own, 1)
    peak, place, n_averaged = average_peaks(curvature_per_m, row, used, average.half_width)
    cycle, frame = _largest_by_cycle(row, peak, n_cycles)
    own = sigma_per_m[frame, place[frame]].astype(np.float64)
    noise = np.minimum(np.nan_to_num(variance[place[frame]]), own**2)
    left = own**2 - noise + noise / n_averaged[frame] + average.bias_per_m**2
    return _Largest(cycle, place[frame], peak[frame], np.sqrt(left), 2 * average.half_width + 1)


def find_peaks(curvature_per_m: Floats32) -> tuple[Floats, Ints]:
    """Return each frame's largest curvature (F,), NaN where it has no curve, and the index of its place (F,)."""
    n_frames = len(curvature_per_m)
    peak, place = np.full(n_frames, np.nan), np.zeros(n_frames, dtype=np.int64)
    for start, stop in chunks(n_frames):
        part = curvature_per_m[start:stop]
        place[start:stop] = np.where(np.isfinite(part), part, -1.0).argmax(axis=1)
        peak[start:stop] = part[np.arange(stop - start), place[start:stop]]
    return peak, place


def find_tighter(curvature_per_m: Floats32, limit_per_m: float) -> Bools:
    """Return for each frame (F,) whether its curvature (F, G) exceeds the limit anywhere."""
    tighter = np.zeros(len(curvature_per_m), dtype=bool)
    for start, stop in chunks(len(curvature_per_m)):
        tighter[start:stop] = (curvature_per_m[start:stop] > limit_per_m).any(axis=1)
    return tighter


def _sum_frames(curvature_per_m: Floats32) -> tuple[Floats, Ints]:
    """Return the sum and the number of each frame's samples."""
    n_frames = len(curvature_per_m)
    total, count = np.zeros(n_frames), np.zeros(n_frames, dtype=np.int64)
    for start, stop in chunks(n_frames):
        part = curvature_per_m[start:stop]
        seen = np.isfinite(part)
        count[start:stop] = seen.sum(axis=1)
        total[start:stop] = np.where(seen, part, 0.0).sum(axis=1, dtype=np.float64)
    return total, count


def _largest_by_cycle(row: Ints, peak: Floats, n_cycles: int) -> tuple[Ints, Ints]:
    """Return the cycles that have a peak (M,) and the frame of the largest of each (M,)."""
    frames = np.flatnonzero(np.isfinite(peak))
    order = frames[np.lexsort((peak[frames], row[frames]))]
    last = np.searchsorted(row[order], np.arange(n_cycles), "right") - 1
    cycle = np.flatnonzero((last >= 0) & (row[order[last]] == np.arange(n_cycles))) if len(order) else frames
    return cycle, order[last[cycle]]
