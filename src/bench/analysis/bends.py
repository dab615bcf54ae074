"""From curvature in every frame to the figures of a cycle and of a place on the path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints, chunks

__all__ = ["TRUSTED_CONFIDENCE", "CycleBends", "find_peaks", "find_tighter", "map_by_phase", "summarise_cycles"]

TRUSTED_CONFIDENCE = 0.75
"""Frames below this confidence do not enter a cycle's figures: a quarter of their markers is missing or doubtful."""


@dataclass(frozen=True, eq=False)
class CycleBends:
    """The bending of each of C cycles; NaN where no trusted frame has a curve."""

    n_frames: Ints
    complete_fraction: Floats
    """Part of the frames in which every marker was found."""
    max_curvature_per_m: Floats
    """Largest curvature of any trusted frame at any place."""
    max_curvature_sigma_per_m: Floats
    """Its standard deviation."""
    max_curvature_arc_length_m: Floats
    """Its place."""
    mean_curvature_per_m: Floats
    """Mean over trusted frames and the places where they have a curve."""


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

    Parameters
    ----------
    row : (F,)
        Each frame's cycle, 0 to C - 1, -1 outside any.
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
    peak, place = find_peaks(curvature_per_m)
    total, count = _sum_frames(curvature_per_m)
    used = np.flatnonzero(inside & trusted & (count > 0))
    sums = np.bincount(row[used], total[used], minlength=n_cycles)
    counts = np.bincount(row[used], count[used], minlength=n_cycles)
    top = _largest_by_cycle(row[used], peak[used], n_cycles)
    has = top >= 0
    frame = used[top[has]]
    columns = np.full((3, n_cycles), np.nan)
    columns[:, has] = peak[frame], sigma_per_m[frame, place[frame]], arc_length_m[place[frame]]
    with np.errstate(invalid="ignore"):
        return CycleBends(n_frames, n_complete / n_frames, columns[0], columns[1], columns[2], sums / counts)


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


def map_by_phase(curvature_per_m: Floats32, phase: Floats, trusted: Bools, n_bins: int) -> Floats:
    """Return the median curvature (P, G) of all trusted frames in each of P equal phase bins, NaN where none is."""
    bins = np.full(len(phase), -1)
    known = trusted & np.isfinite(phase)
    bins[known] = np.minimum((phase[known] * n_bins).astype(np.int64), n_bins - 1)
    order = np.argsort(bins, kind="stable")
    bounds = np.searchsorted(bins[order], np.arange(n_bins + 1))
    result = np.full((n_bins, curvature_per_m.shape[1]), np.nan)
    for i in range(n_bins):
        if bounds[i + 1] > bounds[i]:
            result[i] = _median_of_rows(curvature_per_m[order[bounds[i] : bounds[i + 1]]])
    return result


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


def _largest_by_cycle(row: Ints, peak: Floats, n_cycles: int) -> Ints:
    """Return for each cycle the index of its largest peak in `peak`, -1 for a cycle without one."""
    order = np.lexsort((peak, row))
    last = np.searchsorted(row[order], np.arange(n_cycles), "right") - 1
    index = np.full(n_cycles, -1)
    if len(order):
        has = (last >= 0) & (row[order[last]] == np.arange(n_cycles))
        index[has] = order[last[has]]
    return index


def _median_of_rows(values: Floats32) -> Floats:
    """Return the median (G,) over the rows, without their NaNs; NaN where nothing else is."""
    ascending = np.sort(values, axis=0)  # NaNs go last
    count = np.isfinite(ascending).sum(axis=0)
    column = np.arange(values.shape[1])
    low, high = np.maximum((count - 1) // 2, 0), np.minimum(count // 2, len(values) - 1)
    middle = (ascending[low, column].astype(np.float64) + ascending[high, column]) / 2
    return np.where(count > 0, middle, np.nan)
