"""Cycles of a take without a robot: found by the motion coming back, on points that nobody has labeled.

Each moment gets a signature: how many points lie about each of some places in space. It needs no labels, a hidden
marker or a ghost changes it by one point, and it is the same whenever the cable is in the same pose. Where the
signature repeats at least three times, and each time as the other times foretell, the take has cycles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints
from bench.analysis.cycles.table import CycleTable

__all__ = ["find_repeated_cycles"]

N_PLACES = 48
"""Of the signature: enough to tell the poses of a cable apart, and few enough for hours of frames."""
WIDTH_SHARE = 1 / 24
"""Width of a place, as part of the diagonal of all that is seen: wider ones tell the moment of a pose less well.

Chosen on made takes (`DEVELOPMENT`), where 1/8 finds starts to 0.007 of a cycle on average, 1/24 and less to 0.002.
"""
SHORTEST_STEP_S = 0.02
MOST_STEPS = 100_000
"""Moments looked at: 50 a second for half an hour, fewer in longer takes."""
SMOOTHED_STEPS = 5
"""A ghost lives for about 4 frames of 100 Hz."""
N_COMPONENTS = 8
"""A moving cable's signature has few; noise has all."""
FEWEST_CYCLES = 3
LEAST_LIKENESS = 0.5
"""Correlation of the take with itself a period later; nine real takes that do not repeat have 0.41 at most."""
LEAST_FORETOLD = 0.65
"""Share of a cycle's motion that the mean of the others gives: as much or more in all 112 made takes that repeat, in 5
of 72 that only nearly do (other seeds of `DEVELOPMENT`), and in no real one that does not."""
NEARLY_AS_LIKE = 0.9
"""The shortest period that is as good as the best but for this is taken, and not a multiple of it."""
WINDOW_SHARE = 1 / 2
"""What is matched to find a start reaches so far to either side of it, as part of the period.

Half finds it three times as well as a quarter, and of two cycles of different length still the moment between them.
"""
REACH_SHARE = 0.15
"""How much a cycle may be longer or shorter than the period."""
REST_SHARE = 0.1
"""Slower than this part of the usual speed is rest."""
SHORTEST_REST = 0.08
"""Part of the period that a rest must last."""
AT_REST = 0.35
"""As part of the motion's size: nearer than this to the resting pose is there."""
N_PHASES = 64

_CHUNK = 2_000


@dataclass(frozen=True, eq=False)
class _Signal:
    """The signature at T moments that are `step_ns` apart."""

    values: Floats
    """(T, c): about their mean."""
    start_ns: int
    step_ns: float

    def __len__(self) -> int:
        return len(self.values)

    @property
    def size(self) -> float:
        """How far the signature goes from its mean, root mean square."""
        return float(np.sqrt(np.square(self.values).sum(axis=1).mean()))


@dataclass(frozen=True, eq=False)
class _Rest:
    """Where the mean cycle rests."""

    end: float
    """Phase at which motion begins, by the marks."""
    share: float
    """Part of the cycle that it lasts."""
    pose: Floats
    """(c,): the signature there."""


def find_repeated_cycles(points_m: Floats32, offsets: Ints, time_ns: Ints) -> CycleTable | None:
    """Find the cycles of a take in which a motion repeats at least three times; None where none does.

    A cycle begins where motion begins after the longest rest of each cycle; without a rest, in the same pose as the
    take. What the take has of a cycle before its first start and after its last is a cycle that is not complete, unless
    nothing moves there.

    Parameters
    ----------
    points_m : (N, 3)
        All points of all frames, lab frame.
    offsets : (F + 1,)
        Points of frame f are ``points_m[offsets[f]:offsets[f + 1]]``.
    time_ns : (F,)
        Capture times, ascending.
    """
    signal = _make_signal(points_m, offsets, time_ns)
    if signal is None or signal.size == 0.0:
        return None
    period = _find_period(signal.values)
    if period == 0:
        return None
    marks = _follow(signal.values, np.array([period * WINDOW_SHARE]), period)
    if len(marks) < FEWEST_CYCLES:
        return None
    rest = _find_rest(signal.values, marks)
    starts = _move_starts(signal.values, marks, period, rest)
    if rest is None:
        starts[0] = 0.0
    if len(starts) < FEWEST_CYCLES or _foretold_share(signal.values, starts) < LEAST_FORETOLD:
        return None
    table = _make_table(signal, starts, rest, int(time_ns[-1]))
    return table if table.complete.sum() >= FEWEST_CYCLES else None


def _make_signal(points_m: Floats32, offsets: Ints, time_ns: Ints) -> _Signal | None:
    known = np.flatnonzero(np.isfinite(points_m).all(axis=1))
    if len(time_ns) < FEWEST_CYCLES * SMOOTHED_STEPS or not len(known):
        return None
    span_ns = int(time_ns[-1] - time_ns[0])
    step_ns = max(SHORTEST_STEP_S * 1e9, float(np.median(np.diff(time_ns))), span_ns / MOST_STEPS)
    moments = time_ns[0] + (np.arange(int(span_ns / step_ns) + 1) * step_ns).astype(np.int64)
    frames = np.minimum(np.searchsorted(time_ns, moments), len(time_ns) - 1)
    drawn = np.random.default_rng(0).choice(known, N_PLACES)  # any places that points have been in do
    low, high = np.quantile(points_m[known], [0.05, 0.95], axis=0)
    width_m = float(np.linalg.norm(high - low)) * WIDTH_SHARE
    if width_m == 0.0 or len(frames) < FEWEST_CYCLES * SMOOTHED_STEPS:
        return None
    counts = np.concatenate(
        [
            _count_about(points_m, offsets, frames[begin : begin + _CHUNK], points_m[drawn], width_m)
            for begin in range(0, len(frames), _CHUNK)
        ]
    )
    counts = _smooth(counts)
    counts -= counts.mean(axis=0)
    _, vectors = np.linalg.eigh(counts.T @ counts)
    return _Signal(counts @ vectors[:, -N_COMPONENTS:], int(time_ns[0]), step_ns)


def _count_about(points_m: Floats32, offsets: Ints, frames: Ints, places_m: Floats32, width_m: float) -> Floats:
    """Return how many points of each frame lie about each place, (f, p): a point counts less the further it is off."""
    count = offsets[frames + 1] - offsets[frames]
    first = np.cumsum(count) - count
    index = np.arange(int(count.sum())) + np.repeat(offsets[frames] - first, count)
    apart = points_m[index, None, :] - places_m
    near = np.nan_to_num(np.exp(-np.square(apart).sum(axis=2) / (2 * width_m**2)))
    found = np.zeros((len(frames), len(places_m)))
    filled = count > 0
    if filled.any():
        found[filled] = np.add.reduceat(near, first[filled], axis=0)
    return found


def _smooth(values: Floats) -> Floats:
    half = SMOOTHED_STEPS // 2
    sums = np.cumsum(np.pad(values, ((half + 1, half), (0, 0)), mode="edge"), axis=0)
    return np.asarray((sums[SMOOTHED_STEPS:] - sums[:-SMOOTHED_STEPS]) / SMOOTHED_STEPS)


def _find_period(values: Floats) -> int:
    """Return the shortest lag (steps) after which the signal is nearly as like itself as ever; 0 if never."""
    n, longest = len(values), len(values) // FEWEST_CYCLES
    spectrum = np.fft.rfft(values, 1 << (2 * n - 1).bit_length(), axis=0)
    product = np.fft.irfft(np.square(np.abs(spectrum)).sum(axis=1))[: longest + 1]
    sums = np.concatenate([[0.0], np.cumsum(np.square(values).sum(axis=1))])
    lag = np.arange(longest + 1)
    likeness = product / np.sqrt(np.maximum(sums[n - lag] * (sums[n] - sums[lag]), 1e-300))
    unlike = np.flatnonzero(likeness < LEAST_LIKENESS)
    if not len(unlike):
        return 0
    middle = likeness[1:-1]
    peaks = 1 + np.flatnonzero((middle > likeness[:-2]) & (middle >= likeness[2:]))
    peaks = peaks[(peaks > unlike[0]) & (likeness[peaks] >= LEAST_LIKENESS)]
    good = peaks[likeness[peaks] >= NEARLY_AS_LIKE * likeness[peaks].max(initial=0.0)]
    return int(good[0]) if len(good) else 0


def _follow(values: Floats, starts: Floats, period: float) -> Floats:
    """Find the moments (steps) that are like the first of `starts`, one a cycle; the others are where to look.

    Then again, by the mean of what is about all of them.
    """
    half = int(period * WINDOW_SHARE)
    template = _cut(values, starts[:1], half)
    found = starts
    for _ in range(3):
        found = _match_all(values, template, found, period)
        template = _cut(values, found, half)
    return found


def _cut(values: Floats, starts: Floats, half: int) -> Floats:
    """Return the mean (2 half + 1, c) of what is about some moments, as far as the take goes there."""
    index = np.rint(starts).astype(np.int64)[:, None] + np.arange(-half, half + 1)
    inside = (index >= 0) & (index < len(values))
    near = np.where(inside[..., None], values[np.clip(index, 0, len(values) - 1)], 0.0)
    return np.asarray(near.sum(axis=0) / np.maximum(inside.sum(axis=0), 1)[:, None])


def _match_all(values: Floats, template: Floats, expected: Floats, period: float) -> Floats:
    """Find one moment a cycle, near where it is expected and, behind these, a period after the one before."""
    reach = max(int(period * REACH_SHARE), 1)
    found: list[float] = []
    looked = list(expected)
    while True:
        place = looked[len(found)] if len(found) < len(looked) else found[-1] + period
        if place > len(values) - 1:
            return np.array(found)
        moment = _match(values, template, round(place), reach)
        if found and moment <= found[-1]:
            return np.array(found)
        found.append(moment)


def _match(values: Floats, template: Floats, place: int, reach: int) -> float:
    """Return the moment within reach of a place about which the signal is most like the template."""
    half = len(template) // 2
    moments = np.arange(max(place - reach, 0), min(place + reach, len(values) - 1) + 1)
    index = moments[:, None] + np.arange(-half, half + 1)
    inside = (index >= 0) & (index < len(values))
    squares = np.square(values[np.clip(index, 0, len(values) - 1)] - template).sum(axis=2)
    cost = np.where(inside, squares, 0.0).sum(axis=1) / inside.sum(axis=1)
    best = int(cost.argmin())
    if not 0 < best < len(cost) - 1:
        return float(moments[best])
    before, at, after = cost[best - 1 : best + 2]
    return float(moments[best] + 0.5 * (before - after) / max(before - 2 * at + after, 1e-300))


def _cycles_of(values: Floats, starts: Floats) -> Floats:
    """Return the cycles between the starts as rows of equal length, (n, N_PHASES, c)."""
    place = starts[:-1, None] + np.diff(starts)[:, None] * (np.arange(N_PHASES) + 0.5) / N_PHASES
    low = np.clip(place.astype(np.int64), 0, len(values) - 2)
    share = (place - low)[..., None]
    return np.asarray(values[low] * (1 - share) + values[low + 1] * share)


def _foretold_share(values: Floats, starts: Floats) -> float:
    """Return how much of a cycle's motion the mean of the other cycles gives: 1 all of it, 0 or less nothing."""
    cycles = _cycles_of(values, starts)
    n = len(cycles)
    left = (cycles - cycles.mean(axis=0)) * n / (n - 1)
    return float(1.0 - np.square(left).sum() / np.square(cycles - cycles.mean(axis=(0, 1))).sum())


def _find_rest(values: Floats, marks: Floats) -> _Rest | None:
    """Find the longest rest of the mean cycle; of several of nearly that length the first in the take."""
    mean = _cycles_of(values, marks).mean(axis=0)
    speed = np.linalg.norm(np.roll(mean, -1, axis=0) - np.roll(mean, 1, axis=0), axis=1)
    still = speed < REST_SHARE * np.quantile(speed, 0.9)
    if still.all() or not still.any():
        return None
    turned = int(np.flatnonzero(~still)[0])  # begin in motion, so that no rest is cut in two
    still = np.roll(still, -turned)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    first, stop = edges[::2], edges[1::2]
    length = stop - first
    if length.max() < SHORTEST_REST * N_PHASES:
        return None
    chosen = int(np.flatnonzero(length >= NEARLY_AS_LIKE * length.max())[0])
    middle = (np.arange(first[chosen], stop[chosen]) + turned) % N_PHASES
    end = (stop[chosen] + turned) % N_PHASES / N_PHASES
    return _Rest(float(end), float(length[chosen]) / N_PHASES, mean[middle].mean(axis=0))


def _move_starts(values: Floats, marks: Floats, period: int, rest: _Rest | None) -> Floats:
    """Return the starts (steps): the end of each rest, or the places where the take began."""
    usual = float(np.median(np.diff(marks)))
    begin = rest.end if rest else -marks[0] / usual
    expected = marks + begin * usual
    expected = np.concatenate([[expected[0] - usual], expected])
    return _follow_from(values, expected[expected >= -0.5], period)


def _follow_from(values: Floats, expected: Floats, period: int) -> Floats:
    half = int(period * WINDOW_SHARE)
    return _match_all(values, _cut(values, expected, half), np.maximum(expected, 0.0), period)


def _make_table(signal: _Signal, starts: Floats, rest: _Rest | None, last_ns: int) -> CycleTable:
    usual = float(np.median(np.diff(starts)))
    start_ns = signal.start_ns + np.rint(starts * signal.step_ns).astype(np.int64)
    bounds = [*start_ns.tolist(), last_ns + 1]
    complete = [True] * (len(starts) - 1)
    left = len(signal) - 1 - starts[-1]
    complete.append(bool(left >= (1.0 - REACH_SHARE / 2 - (rest.share if rest else 0.0)) * usual))
    seen = [True] * len(complete)
    if not complete[-1] and not _moves(signal, starts[-1], len(signal), rest):
        bounds, complete, seen = bounds[:-1], complete[:-1], seen[:-1]
    if starts[0] >= 1.0 and _moves(signal, 0.0, starts[0], rest):
        bounds, complete, seen = [signal.start_ns, *bounds], [False, *complete], [False, *seen]
    edges, yes = np.array(bounds), np.ones(len(complete), dtype=bool)
    return CycleTable(np.arange(len(complete)), edges[:-1], edges[1:], np.array(complete), yes, np.array(seen))


def _moves(signal: _Signal, begin: float, end: float, rest: _Rest | None) -> Bools | bool:
    """Tell whether anything leaves the resting pose between two moments; without a rest everything does."""
    part = signal.values[int(np.ceil(begin)) : int(end)]
    if rest is None or not len(part):
        return rest is None and len(part) > 0
    apart = np.linalg.norm(part - rest.pose, axis=1)
    return bool(np.quantile(apart, 0.9) > AT_REST * signal.size)
