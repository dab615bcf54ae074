"""What the cable usually does at each place of the robot's path: noise averaged away over cycles, the band kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints, median_of_rows
from bench.analysis.curvature.local_average import estimate_noise_variance

__all__ = ["LargestBend", "PhaseMean", "average_by_phase", "find_largest_bend"]

MEDIAN_VARIANCE = np.pi / 2
"""Of the median of many normal values, in units of that of their mean."""


@dataclass(frozen=True, eq=False)
class PhaseMean:
    """Curvature, or a component of it, by P equal bins of cycle phase and G places."""

    curvature_per_m: Floats
    """(P, G): median over all frames of the bin, NaN where there is none."""
    sigma_per_m: Floats
    """(P, G): its standard deviation."""
    n_frames: Ints
    """(P, G): of how many frames."""


@dataclass(frozen=True)
class LargestBend:
    """The largest curvature of a map."""

    curvature_per_m: float
    sigma_per_m: float
    cycle_phase: float
    """Centre of its bin."""
    arc_length_m: float


def average_by_phase(
    curvature_per_m: Floats32, sigma_per_m: Floats32, row: Ints, phase: Floats, trusted: Bools, n_bins: int
) -> PhaseMean:
    """Average frames of equal phase over all cycles.

    The median, so that some wrongly sorted frames change nothing. Its standard deviation has two parts: the noise from
    frame to frame, as measured from the recording, which falls with the root of the number of frames; and the rest of
    what the method states, which is the same in every cycle and stays.

    Parameters
    ----------
    curvature_per_m, sigma_per_m : (F, G)
        NaN where there is no curve. Signed components of the curvature vector average as well as its magnitude.
    row : (F,)
        Each frame's cycle, -1 outside any; frames in order of time.
    phase : (F,)
        0 to 1, NaN outside a cycle.
    trusted : (F,)
        Frames that may enter.
    n_bins : int
        P.
    """
    noise = np.nan_to_num(estimate_noise_variance(curvature_per_m, sigma_per_m, row, trusted))
    shape = n_bins, curvature_per_m.shape[1]
    median, sigma, count = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=np.int64)
    for i, frames in _frames_of_bins(phase, trusted, n_bins):
        median[i] = median_of_rows(curvature_per_m[frames])
        stated = median_of_rows(sigma_per_m[frames]) ** 2
        count[i] = np.isfinite(curvature_per_m[frames]).sum(axis=0)
        falls = np.minimum(noise, stated)
        share = np.where(count[i] > 2, MEDIAN_VARIANCE, 1.0) / np.maximum(count[i], 1)
        sigma[i] = np.sqrt(stated - falls * (1.0 - share))
    return PhaseMean(median, sigma, count)


def find_largest_bend(mean: PhaseMean, arc_length_m: Floats) -> LargestBend | None:
    """Return the largest curvature of the map at places (G,), None where it is empty.

    Of the usual cycle, where the largest single frame is that of the worst one with its noise.
    """
    known = np.where(np.isfinite(mean.curvature_per_m), mean.curvature_per_m, -np.inf)
    if not np.isfinite(known).any():
        return None
    i, g = np.unravel_index(int(known.argmax()), known.shape)
    value, sigma = float(mean.curvature_per_m[i, g]), float(mean.sigma_per_m[i, g])
    return LargestBend(value, sigma, (float(i) + 0.5) / len(known), float(arc_length_m[g]))


def _frames_of_bins(phase: Floats, trusted: Bools, n_bins: int) -> Iterator[tuple[int, Ints]]:
    """Yield each bin that has trusted frames, with these."""
    bins = np.full(len(phase), -1)
    known = trusted & np.isfinite(phase)
    bins[known] = np.minimum((phase[known] * n_bins).astype(np.int64), n_bins - 1)
    order = np.argsort(bins, kind="stable")
    bounds = np.searchsorted(bins[order], np.arange(n_bins + 1))
    for i in np.flatnonzero(np.diff(bounds)).tolist():
        yield i, order[bounds[i] : bounds[i + 1]]
