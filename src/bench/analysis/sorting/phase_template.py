"""Where each marker is at each place of the robot's path, and how far a cycle strays from that: learnt from cycles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bench.analysis.arrays import Floats, Floats32, Ints

__all__ = ["FEWEST_SHOWING", "PhaseTemplate", "lay_over_cycles", "learn_template", "refresh_template"]

FEWEST_SHOWING = 3
"""That show a marker at a place of the path: of fewer, one wrong label moves the median."""
HALF_WAY = 0.45
"""Of the distance to the next marker."""
LAGS = (1, 2, 4, 8, 16, 32, 64)
"""Bins after which straying is measured; between them it is interpolated."""
CHI_3 = {0.75: 2.027, 0.95: 2.795}
"""Quantiles of the length of three normal numbers, in standard deviations. Straying has longer tails than they: it is
read where 95 % of the values lie, or 75 % where many labels may be wrong."""
ROUNDS = 4
"""Of the median, each with the gaps filled by the one before; after two a median of ten cycles that stray by 8 mm still
leaps by 5 mm in places."""
LEAP_BINS = 9
"""Around a place, of which the median is right when less than half of them are wrong."""
LONGEST_BRIDGE = 5
"""Bins without enough cycles over which a straight line is a marker's way: 50 ms of 4 s at 100 Hz."""
CLOSED_SIGMAS = 3.0
"""Of a cycle's straying, by which a closed path's two ends may differ; they are medians of several cycles."""
LONGEST_STEP = 3.0
"""Times the usual step from frame to frame: over a longer gap nothing is interpolated."""


@dataclass(frozen=True, eq=False)
class PhaseTemplate:
    """The usual cycle of a cable with k markers, in B bins of phase."""

    position_m: Floats
    """(B + 1, k, 3): median over cycles at phase b / B, lab frame; NaN where it was seen in too few."""
    sigma_m: Floats
    """(k, 65): by how much, in each coordinate, a marker's distance from the template changes in so many bins.

    Standard deviation; the first two entries are those of one bin, the last is the distance itself.
    """
    reach_m: Floats
    """(k,): nearly half the way to the next marker: what is farther from a marker's place is another one."""
    bin_s: float
    """Usual duration of a bin."""
    left: Ints
    """(k,): the neighbour that is compared with on one side, -1 for the anchor, which strays by nothing."""
    right: Ints
    """(k,): the other one; the last marker has both on one side."""
    weight: Floats
    """(k, 2): of `left` and `right`, so that a straight line between their distances gives the marker's."""
    beside_sigma_m: Floats
    """(k,): how far a marker strays from what its two neighbours do, in each coordinate."""
    n_cycles: int
    """Cycles from which it was learnt."""
    warnings: tuple[str, ...] = ()
    """What is to be said of how those cycles were sorted."""

    @property
    def cycle_sigma_m(self) -> float:
        """How far a cycle strays from the template in each coordinate: the worst known marker's standard deviation."""
        known = self.sigma_m[:, -1][np.isfinite(self.sigma_m[:, -1])]
        return float(known.max(initial=0.0)) if len(known) else float("inf")


def half_way_to_next(arc_length_m: Floats) -> Floats:
    """Return (k,) how far from its place a marker may be looked for, so that it is not taken for the next one."""
    spacing = np.diff(arc_length_m, prepend=0.0)
    return np.asarray(HALF_WAY * np.minimum(spacing, np.append(spacing[1:], np.inf)))


def lay_over_cycles(position_m: Floats32, cycle: Ints, phase: Floats, cycles: Sequence[int], n_bins: int) -> Floats:
    """Return markers at the same phases of several cycles: (C, B + 1, k, 3), NaN where a neighbouring frame has none.

    Between two frames a straight line; beyond a cycle's first and last one, on for at most one step.

    Parameters
    ----------
    position_m : (F, k, 3)
        Sorted markers, NaN where not found.
    cycle, phase : (F,)
        Frames in order of time.
    cycles : sequence of C int
        Which cycles.
    n_bins : int
        B.
    """
    laid = np.full((len(cycles), n_bins + 1, *position_m.shape[1:]), np.nan)
    wanted = np.arange(n_bins + 1) / n_bins
    for row, index in enumerate(cycles):
        frames = np.flatnonzero(cycle == index)
        frames = frames[np.argsort(phase[frames], kind="stable")]
        if len(frames) < 2:
            continue
        known = phase[frames]
        after = np.clip(np.searchsorted(known, wanted), 1, len(frames) - 1)
        step = known[after] - known[after - 1]
        usable = (step > 0) & (step <= LONGEST_STEP * np.median(np.diff(known)))
        share = (wanted - known[after - 1]) / np.where(usable, step, 1.0)
        usable &= (share >= -1.0) & (share <= 2.0)
        share = share[:, None, None]
        line = (1.0 - share) * position_m[frames[after - 1]] + share * position_m[frames[after]]
        laid[row] = np.where(usable[:, None, None], line, np.nan)
    return laid


def learn_template(
    laid_m: Floats,
    arc_length_m: Sequence[float],
    bin_s: float,
    least_sigma_m: float,
    *,
    is_anchored: bool,
    share: float,
) -> PhaseTemplate:
    """Learn the usual cycle from C cycles laid over each other.

    Parameters
    ----------
    laid_m : (C, B + 1, k, 3)
        NaN where a marker is not surely found.
    arc_length_m : sequence of k float
        Of the markers, ascending.
    bin_s : float
        Usual duration of a bin.
    least_sigma_m : float
        Smaller than a marker's noise no straying is believed.
    is_anchored : bool
        Whether the cable's start is held, so that it does not stray.
    share : float
        Quantile at which straying is read, of `CHI_3`: less where many labels may be wrong.
    """
    arc_length = np.asarray(arc_length_m, dtype=np.float64)
    reach = half_way_to_next(arc_length)
    position = median_over_cycles(laid_m, reach)
    stray = laid_m - position
    left, right, weight = _neighbours(arc_length, is_anchored)
    beside = weight[:, :1] * np.where((left >= 0)[:, None], stray[:, :, left], 0.0) + weight[:, 1:] * stray[:, :, right]
    sigma = np.maximum(_sigma_by_lag(stray, share), least_sigma_m)
    beside_sigma = np.maximum(_sigma_at(share, stray - beside), least_sigma_m)
    return PhaseTemplate(
        position_m=_close(position, sigma),
        reach_m=reach,
        sigma_m=sigma,
        bin_s=bin_s,
        left=left,
        right=right,
        weight=weight,
        beside_sigma_m=beside_sigma if len(left) > 2 else np.full(len(left), np.inf),
        n_cycles=len(laid_m),
    )


def refresh_template(template: PhaseTemplate, laid_m: Floats) -> PhaseTemplate:
    """Return the template with the median of newer cycles (C, B + 1, k, 3) where they show enough."""
    stray = _believed(laid_m - template.position_m, template.reach_m)
    moved = np.nan_to_num(_plain_median(stray))
    position = np.where(np.isnan(template.position_m), _plain_median(laid_m), template.position_m + moved)
    return replace(template, position_m=_close(position, template.sigma_m))


def median_over_cycles(laid_m: Floats, reach_m: Floats) -> Floats:
    """Return (B + 1, k, 3): the median over cycles of each place that enough of them show, else NaN.

    The cycles that show a marker are others from place to place. So that the median does not leap with them, a cycle
    that does not show it, or farther off than `reach_m` (k,), is taken to stray there as it does before and after.
    """
    usual = _bridge(_without_leaps(_plain_median(laid_m), reach_m))
    for _ in range(ROUNDS):
        stray = _believed(laid_m - usual, reach_m)
        usual = np.where(np.isnan(usual), np.nan, _plain_median(usual + stray))
    return usual


def _believed(stray: Floats, reach_m: Floats) -> Floats:
    """Return by how much cycles (C, B + 1, k, 3) stray, without what is another marker and with the gaps filled."""
    known = np.where(np.linalg.norm(stray, axis=-1, keepdims=True) <= reach_m[:, None], stray, np.nan)
    for cycle in known:
        _interpolate(cycle)
    return known


def _close(position_m: Floats, sigma_m: Floats) -> Floats:
    """Return a template that ends where it begins, if it nearly does: a closed path, on which the next cycle follows.

    The medians of both ends differ by chance, and a marker does not leap by that from one cycle to the next.
    """
    gap = position_m[-1] - position_m[0]
    is_closed = np.linalg.norm(gap, axis=1) <= CLOSED_SIGMAS * sigma_m[:, -1]
    share = np.linspace(-0.5, 0.5, len(position_m))[:, None, None]
    return np.asarray(position_m - share * np.where(is_closed[:, None], gap, 0.0))


def _plain_median(laid_m: Floats) -> Floats:
    ordered = np.sort(laid_m, axis=0)  # NaN last
    n_known = np.isfinite(laid_m[..., :1]).sum(axis=0)
    below, above = (n_known - 1) // 2, n_known // 2
    middle = [np.take_along_axis(ordered, np.maximum(index, 0)[None], axis=0)[0] for index in (below, above)]
    return np.asarray(np.where(n_known >= FEWEST_SHOWING, (middle[0] + middle[1]) / 2, np.nan))


def _without_leaps(usual_m: Floats, reach_m: Floats) -> Floats:
    """Return a template (B + 1, k, 3) without places where most cycles are wrong, told by those before and after."""
    filled = usual_m.copy()
    _interpolate(filled)
    around = scipy.ndimage.median_filter(np.nan_to_num(filled), size=(LEAP_BINS, 1, 1), mode="nearest")
    return np.where(np.linalg.norm(usual_m - around, axis=-1, keepdims=True) <= reach_m[:, None], usual_m, np.nan)


def _bridge(usual_m: Floats) -> Floats:
    """Return a template (B + 1, k, 3) with short gaps filled by straight lines."""
    filled = usual_m.copy()
    _interpolate(filled)
    for marker, unknown in enumerate(np.isnan(usual_m[..., 0]).T):
        edges = np.diff(unknown.astype(np.int8), prepend=0, append=0)
        for first, stop in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
            if stop - first > LONGEST_BRIDGE:
                filled[first:stop, marker] = np.nan
    return filled


def _interpolate(values: Floats) -> None:
    """Fill gaps of (B + 1, k, 3) along the first axis by straight lines, at both ends by the nearest value."""
    bins = np.arange(len(values))
    for marker, unknown in enumerate(np.isnan(values[..., 0]).T):
        if unknown.any() and not unknown.all():
            known = np.flatnonzero(~unknown)
            for axis in range(3):
                values[unknown, marker, axis] = np.interp(bins[unknown], known, values[known, marker, axis])


def _sigma_by_lag(stray: Floats, share: float) -> Floats:
    """Return (k, 65): straying after 0 to 63 bins, and altogether."""
    whole = _sigma_at(share, stray)
    known = [np.fmin(_sigma_at(share, stray[:, lag:] - stray[:, :-lag]), whole) for lag in LAGS if lag < stray.shape[1]]
    by_lag = np.array([known[0], *known, whole])
    lags = np.array([0, *LAGS[: len(known)], LAGS[-1] + 1])
    wanted = np.arange(LAGS[-1] + 1)
    table = np.array([np.interp(wanted, lags, column) for column in by_lag.T])
    table[:, -1] = whole
    return table


def _sigma_at(share: float, stray: Floats) -> Floats:
    """Return (k,): standard deviation of each coordinate of vectors (..., k, 3), infinite where there are none."""
    distance = np.linalg.norm(stray, axis=-1).reshape(-1, stray.shape[-2])
    known = [column[np.isfinite(column)] for column in distance.T]
    return np.array([np.quantile(one, share) if len(one) else np.inf for one in known]) / CHI_3[share]


def _neighbours(arc_length_m: Floats, is_anchored: bool) -> tuple[Ints, Ints, Floats]:
    """Return for each marker two others and their weights (k, 2): those beside it, at an end the next two."""
    k = len(arc_length_m)
    left, right = np.arange(k) - 1, np.minimum(np.arange(k) + 1, k - 1)
    if k > 2:
        left[-1], right[-1] = k - 3, k - 2
        if not is_anchored:
            left[0], right[0] = 1, 2
    place = np.concatenate([arc_length_m, [0.0]])  # the anchor's index is -1
    share = (arc_length_m - place[left]) / (place[right] - place[left])
    return left, right, np.stack([1.0 - share, share], axis=1)
