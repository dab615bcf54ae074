"""Averages over frames close by, as many as the noise deserves and the motion allows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from bench.analysis.arrays import Bools, Floats, Floats32, Ints, chunks, median_of_rows

__all__ = ["LocalAverage", "average_peaks", "choose_width", "estimate_noise_variance", "find_stretches"]

Number = TypeVar("Number", np.int64, np.float64)

MOST_TRIPLES = 20_000
"""From which noise is estimated: its standard deviation is then known to 1 %."""
HALF_WIDTHS = (1, 2, 4, 8, 16)
"""Frames to either side that are tried: up to 0.33 s at 100 Hz."""
ASKED = 16
"""Frames to either side of a maximum in which a width is tried."""
MOST_MAXIMA = 400
FEWEST_TRIED = 20
"""Frames, of all maxima together, that must have room for a width."""
OUTLIER = 4.0
"""Standard deviations: a wrongly sorted frame, or a bend's own course."""
MEDIAN_OF_SQUARE = 0.4549
"""Of a standard normal variable: the median of chi squared with one degree of freedom."""


@dataclass(frozen=True, eq=False)
class LocalAverage:
    """How frames are averaged, and what is left of the noise."""

    half_width: int
    """Frames to either side; 0: not at all."""
    bias_per_m: float
    """Root mean square of what averaging takes off a maximum, as far as it can be told from noise."""


def find_stretches(row: Ints) -> tuple[Ints, Ints]:
    """Return for each frame (F,) the first and the last of the neighbours of one cycle to which it belongs."""
    index = np.arange(len(row))
    starts = np.flatnonzero(np.diff(row, prepend=row[:1] - 1))
    stretch = np.searchsorted(starts, index, side="right") - 1
    return starts[stretch], np.append(starts[1:], len(row))[stretch] - 1


def estimate_noise_variance(value: Floats32, sigma: Floats32, row: Ints, usable: Bools) -> Floats:
    """Return the variance of noise from frame to frame at each place (G,), NaN where it cannot be told.

    From second differences over neighbours, which a steady bend does not have. Where the cable moves so fast, or the
    frames are so far apart, that the bend's own show, the stated variance is the limit.
    """
    linked = usable[1:] & usable[:-1] & (row[1:] == row[:-1])
    middle = np.flatnonzero(linked[1:] & linked[:-1]) + 1
    if not len(middle):
        return np.full(value.shape[1], np.nan)
    middle = middle[np.linspace(0, len(middle) - 1, min(len(middle), MOST_TRIPLES)).astype(np.intp)]
    square = (value[middle - 1].astype(np.float64) - 2.0 * value[middle] + value[middle + 1]) ** 2 / 6.0
    usual = median_of_rows(square) / MEDIAN_OF_SQUARE
    kept = square <= OUTLIER**2 * usual
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.where(kept, square, 0.0).sum(axis=0) / kept.sum(axis=0)
    return np.asarray(np.fmin(found, median_of_rows(sigma[middle].astype(np.float64) ** 2)))


def choose_width(value: Floats32, variance: Floats, row: Ints, usable: Bools, frame: Ints, place: Ints) -> LocalAverage:
    """Choose the width of the average with the least risk about the maxima at (frame, place), each (M,).

    The mean square of what the average changes is its squared bias and the part of the noise that it removes; so the
    risk of each width follows without knowing the truth (C. L. Mallows, Some comments on C_p, 1973).
    """
    chosen = np.linspace(0, len(frame) - 1, min(len(frame), MOST_MAXIMA)).astype(np.intp)
    frame, place = frame[chosen], place[chosen]
    asked = frame[:, None] + np.arange(-ASKED - HALF_WIDTHS[-1], ASKED + HALF_WIDTHS[-1] + 1)
    inside = np.clip(asked, 0, len(row) - 1)
    mine = (inside == asked) & usable[inside] & (row[inside] == row[frame][:, None])
    around = np.where(mine, value[inside, place[:, None]], np.nan).astype(np.float64)
    best, least = LocalAverage(0, 0.0), np.inf
    for half in HALF_WIDTHS:
        change, noise = _try_width(around, variance[place], half)
        if len(change) < FEWEST_TRIED:
            break
        noise_left = noise / (2 * half + 1)
        bias2 = float(np.mean(change**2)) - (noise - noise_left)
        if not bias2 + noise_left < min(least, noise):
            break
        best, least = LocalAverage(half, float(np.sqrt(max(bias2, 0.0)))), bias2 + noise_left
    return best


def average_peaks(value: Floats32, row: Ints, usable: Bools, half_width: int) -> tuple[Floats, Ints, Ints]:
    """Return the largest of each frame's averages (F,), its place (F,), and how many frames are in it (F,).

    The average is over as many frames of its cycle before as after, fewer at the cycle's ends. What is not usable, or
    has no curve at a place, is left out of it; and a frame that is not usable, or has no curve there, has no average.
    """
    index, (first, last) = np.arange(len(value)), find_stretches(row)
    half = np.minimum(half_width, np.minimum(index - first, last - index))
    peak, place, count = np.full(len(value), np.nan), np.zeros(len(value), np.int64), np.zeros(len(value), np.int64)
    for start, stop in chunks(len(value)):
        begin, end = max(start - half_width, 0), min(stop + half_width, len(value))
        seen = np.isfinite(value[begin:end]) & usable[begin:end, None]
        low, high = (index - half)[start:stop] - begin, (index + half)[start:stop] + 1 - begin
        counts = _sum_between(seen.astype(np.int64), low, high)
        total = _sum_between(np.where(seen, value[begin:end], 0.0).astype(np.float64), low, high)
        here = seen[start - begin : stop - begin]
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(here, total / counts, -1.0)
        best = mean.argmax(axis=1)
        rows = np.arange(stop - start)
        place[start:stop], count[start:stop] = best, counts[rows, best]
        peak[start:stop] = np.where(here.any(axis=1), mean[rows, best], np.nan)
    return peak, place, count


def _sum_between(value: npt.NDArray[Number], low: Ints, high: Ints) -> npt.NDArray[Number]:
    """Return the sums (C, G) of rows low to high - 1 of (R, G)."""
    running = np.concatenate([np.zeros_like(value[:1]), np.cumsum(value, axis=0)])
    return np.asarray(running[high] - running[low])


def _try_width(around: Floats, variance: Floats, half: int) -> tuple[Floats, float]:
    """Return what an average changes in the frames about the maxima (M, W), and the mean variance of noise there."""
    reach = HALF_WIDTHS[-1]
    window = np.lib.stride_tricks.sliding_window_view(around, 2 * half + 1, axis=1)[:, reach - half :][
        :, : 2 * ASKED + 1
    ]
    change = window.mean(axis=2) - window[:, :, half]
    maximum, offset = np.nonzero(np.isfinite(change) & np.isfinite(variance)[:, None])
    return change[maximum, offset], float(variance[maximum].mean()) if len(maximum) else np.nan
