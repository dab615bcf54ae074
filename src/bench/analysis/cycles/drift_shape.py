"""How far the cable's shape in each cycle is from its shape in the first ones, at the same places on the path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats, Floats32, Ints, chunks, median_of_rows

__all__ = ["CycleShapes", "ShapeDistances", "gather_shapes", "measure_distances"]

MOST_BINS = 20
"""Phase bins in which a cycle's shape is kept: 0.1 s of a 2 s cycle, short against the time in which a cable bends."""
FRAMES_PER_BIN = 4
"""Of the usual cycle: fewer bins for short cycles."""
MOST_TEMPLATE_BINS = 100
"""Bins of the motion that is taken off each frame, with a spline through them: 20 ms of a 2 s cycle.

No more than a usual cycle has frames, or a reference cycle weighs more in what is taken off itself than off others.
"""
LEAST_SEEN = 0.5
"""Part of the places of the usual cycle that must have been seen, or a cycle's distance is not known."""

_CHUNK = 20_000


@dataclass(frozen=True, eq=False)
class CycleShapes:
    """The shape of each of C cycles in P phase bins, k markers: how far they are from a template that all share."""

    offset_m: Floats32
    """(C, P, k, 3): mean offset from the template, NaN where the marker was not seen."""
    noise_m2: Floats32
    """(C, P, k): variance of such a mean that the frames' own scatter leaves, summed over the coordinates."""

    @property
    def n_bins(self) -> int:
        return int(self.offset_m.shape[1])


@dataclass(frozen=True, eq=False)
class ShapeDistances:
    """Each of C cycles against the reference cycles; NaN where too little was seen."""

    distance_m: Floats
    """(C,): root mean square over bins and markers, without what the usual cycle differs by itself."""
    watched_m: Floats
    """(C,): the same with it: scatters evenly about a level, for finding changes."""
    usual_m: float
    """What a reference cycle differs from the others by."""


def gather_shapes(
    row: Ints, n_cycles: int, phase: Floats, position_m: Floats32, trusted: Bools, reference: Bools
) -> CycleShapes:
    """Gather the markers of each cycle by phase.

    Parameters
    ----------
    row : (F,)
        Each frame's cycle, 0 to C - 1, -1 outside any.
    n_cycles : int
        C.
    phase : (F,)
        0…1, NaN outside.
    position_m : (F, k, 3)
        Markers, lab frame, NaN where not found.
    trusted : (F,)
        Frames that may enter.
    reference : (C,)
        The cycles whose mean motion is the template.
    """
    used = np.flatnonzero(trusted & (row >= 0) & np.isfinite(phase))
    per_cycle = np.bincount(row[used], minlength=n_cycles)
    usual = float(np.median(per_cycle[per_cycle > 0])) if len(used) else 0.0
    n_bins = int(np.clip(usual // FRAMES_PER_BIN, 1, MOST_BINS))
    place = np.minimum((phase[used] * n_bins).astype(np.int64), n_bins - 1)
    used = used[np.argsort(row[used] * n_bins + place, kind="stable")]
    template = _make_template(used[reference[row[used]]], phase, position_m, usual)
    n_markers = position_m.shape[1]
    total, squares = np.zeros((2, n_cycles * n_bins, n_markers, 3))
    count = np.zeros((n_cycles * n_bins, n_markers))
    for start, stop in chunks(len(used), _CHUNK):
        frames = used[start:stop]
        offset = position_m[frames] - template.at(phase[frames])
        seen = np.isfinite(offset).all(axis=2)
        offset[~seen] = 0.0
        cell = row[frames] * n_bins + np.minimum((phase[frames] * n_bins).astype(np.int64), n_bins - 1)
        first = np.flatnonzero(np.diff(cell, prepend=-1))
        total[cell[first]] += np.add.reduceat(offset, first, axis=0)
        squares[cell[first]] += np.add.reduceat(offset * offset, first, axis=0)
        count[cell[first]] += np.add.reduceat(seen.astype(np.float64), first, axis=0)
    return _mean_shapes(total, squares, count, n_cycles, n_bins)


class _Template:
    """The markers by phase: a smooth curve through places at ascending phases."""

    def __init__(self, phase: Floats, position_m: Floats, beyond: float) -> None:
        self._curve = scipy.interpolate.make_interp_spline(phase, position_m, k=min(3, len(phase) - 1))
        self._ends = phase[0] - beyond, phase[-1] + beyond

    def at(self, phase: Floats) -> Floats:
        """Return the markers (n, k, 3) at n phases; they go on a little before the first place and after the last."""
        return np.asarray(self._curve(np.clip(phase, *self._ends)))


def _make_template(frames: Ints, phase: Floats, position_m: Floats32, usual: float) -> _Template:
    """Make it from the means of bins, for the markers move in them, and mend these by the medians of what is left."""
    n_bins = int(np.clip(usual, 1, MOST_TEMPLATE_BINS))
    bins = np.minimum((phase[frames] * n_bins).astype(np.int64), n_bins - 1)
    order = np.argsort(bins, kind="stable")
    frames, bins = frames[order], bins[order]
    first = np.flatnonzero(np.diff(bins, prepend=-1))
    if not len(first):
        return _Template(np.zeros(1), np.zeros((1, *position_m.shape[1:])), 0.0)
    n = np.diff(np.append(first, len(bins)))
    centre = np.add.reduceat(phase[frames], first) / n
    known = np.isfinite(position_m[frames])
    position = np.where(known, position_m[frames], 0.0).astype(np.float64)
    count = np.add.reduceat(known.astype(np.float64), first, axis=0)
    with np.errstate(invalid="ignore"):
        mean = _fill_gaps(np.add.reduceat(position, first, axis=0) / count)
    left = np.split(
        (position_m[frames] - _Template(centre, mean, 0.5 / n_bins).at(phase[frames])).astype(np.float32), first[1:]
    )
    return _Template(centre, mean + np.nan_to_num(np.array([_median(part) for part in left])), 0.5 / n_bins)


def _median(values: Floats | Floats32) -> Floats:
    """Return the median over the first axis without its NaNs; NaN where nothing else is."""
    return median_of_rows(values.reshape(len(values), -1)).reshape(values.shape[1:])


def _fill_gaps(place_m: Floats) -> Floats:
    """Fill bins in which a marker was never seen by straight lines: it is only a zero, which all cycles share."""
    flat, index = place_m.reshape(len(place_m), -1), np.arange(len(place_m))
    for column in flat.T:
        known = np.isfinite(column)
        column[~known] = np.interp(index[~known], index[known], column[known]) if known.any() else 0.0
    return place_m


def _mean_shapes(total: Floats, squares: Floats, count: Floats, n_cycles: int, n_bins: int) -> CycleShapes:
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count[..., None]
        scatter = (squares - count[..., None] * mean * mean).sum(axis=2)
        freedom = np.maximum(count - 1, 0).sum(axis=0)
        per_frame = np.nansum(np.where(count > 1, scatter, 0.0), axis=0) / freedom
        noise = per_frame / count
    shape = n_cycles, n_bins, total.shape[1]
    return CycleShapes(
        mean.reshape(*shape, 3).astype(np.float32), np.where(count > 0, noise, np.nan).reshape(shape).astype(np.float32)
    )


def measure_distances(shapes: CycleShapes, reference: Bools) -> ShapeDistances:
    """Measure how far each cycle's shape is from the median of the reference cycles.

    A reference cycle is compared with the median of the others: against one that holds itself it would be too near. The
    noise of its own frames is taken off as far as it is more or less than usual, so that a cycle with many hidden
    markers is not further away for that.

    Parameters
    ----------
    shapes : CycleShapes
    reference : (C,)
        The cycles that are the reference: at least two.
    """
    rows = np.flatnonzero(reference)
    square, noise, seen = _compare(shapes, slice(None), _median(shapes.offset_m[rows]))
    for row in rows:
        one = slice(row, row + 1)
        square[one], noise[one], seen[one] = _compare(shapes, one, _median(shapes.offset_m[rows[rows != row]]))
    known = (seen > 0) & (seen >= LEAST_SEEN * np.median(seen[rows]))
    if not known[rows].any():
        nothing = np.full(len(seen), np.nan)
        return ShapeDistances(nothing, nothing, float("nan"))
    usual_rows = rows[known[rows]]
    square = np.where(known, np.maximum(square - (noise - np.median(noise[usual_rows])), 0.0), np.nan)
    usual = float(np.median(square[usual_rows]))
    return ShapeDistances(np.sqrt(np.maximum(square - usual, 0.0)), np.sqrt(square), float(np.sqrt(usual)))


def _compare(shapes: CycleShapes, rows: slice, centre_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Return for each cycle the mean square distance from a shape, the frames' noise in it, and the places seen."""
    offset, noise = shapes.offset_m[rows], shapes.noise_m2[rows]
    columns = np.full((3, len(offset)), np.nan)
    for start, stop in chunks(len(offset)):
        squares = np.square(offset[start:stop] - centre_m).sum(axis=3)
        known = np.isfinite(squares) & np.isfinite(noise[start:stop])
        count = known.sum(axis=(1, 2))
        columns[0, start:stop] = np.where(known, squares, 0.0).sum(axis=(1, 2)) / np.maximum(count, 1)
        columns[1, start:stop] = np.where(known, noise[start:stop], 0.0).sum(axis=(1, 2)) / np.maximum(count, 1)
        columns[2, start:stop] = count
    return columns[0], columns[1], columns[2]
