"""How the markers of a recording move: learnt from those that are labeled, so that no gate is set in frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Ints
from bench.analysis.sorting.gates import SortSettings, make_gates
from bench.analysis.sorting.point_tracks import PointTracks

__all__ = ["REACH", "MarkerMotion", "find_longest", "learn_motion"]

LAG_S = 0.1
"""Motion is learnt over steps of this: gaps are 0.05 to 0.5 s long."""
LARGEST_MISFIT = 0.5
"""Of a lag: frames this far from it are not compared."""
SAMPLED = 400
"""Frames looked at for each marker: enough for a median to 5 %."""
FEWEST = 12
REACH = 2
"""Markers on each side whose motion a marker follows. On a real cable, of places in the middle of gaps of 0.5 s one in
ten is 16 mm off without them, 2.8 mm with one, 2.1 mm with two on each side."""
RIDGE = 1e-4
MEDIAN_3D = 2.366
"""Median of the squared length of a vector of three normal numbers."""
MEDIAN_1D = 0.4549
HIGH, HIGH_3D = 0.8, 4.642
"""Cables move in fits and starts: the jolts are taken from the livelier part of the recording, and this is the quantile
of the squared length of a vector of three normal numbers."""
USUAL_JOLT = 0.5
USUAL_SPEED_M_S = 0.5
USUAL_CHORD_RATE = 1e-5
"""m²/s³, m/s and m²/s, where a recording is too short to tell: as on a real cable moved at up to 1 m/s."""
NOISE_SIGMAS = 6.0
"""The distance between two noisy markers exceeds its bound by less."""
CLUTTER_M = 0.02
"""Ghosts are counted within this of markers that are seen: those farther off are no danger."""


@dataclass(frozen=True, eq=False)
class MarkerMotion:
    """How k markers move, from one to the next and in time."""

    weight: Floats
    """(k, k): how much of each other marker's motion a marker follows."""
    jolt_m2_s3: Floats
    """(k,): density of the white noise that its acceleration relative to them is."""
    speed_m2_s2: Floats
    """(k,): variance of its speed relative to them."""
    noise_m2: Floats
    """(k,): variance of its measured place, each axis."""
    chord_rate_m2_s: Floats
    """(k - 1,): growth of the variance of a distance between neighbours."""
    chord_noise_m2: Floats
    """(k - 1,): variance of it without time passing."""
    longest_m: Floats
    """(k - 1,): no distance between neighbours is longer."""
    log_clutter: float
    """Logarithm of the number of ghosts in a cubic metre close to markers."""


def learn_motion(tracks: PointTracks, source: Ints, settings: SortSettings, *, is_alone: bool) -> MarkerMotion:
    """Learn from labeled points `source` (k, F) how markers move.

    Parameters
    ----------
    tracks : PointTracks
    source : (k, F)
        Point of each marker, -1 without.
    settings : SortSettings
        A marker's noise is at least that stated, and no distance is longer than the gates are wide.
    is_alone : bool
        Let each marker move by itself: while little is labeled, those beside it are not to be trusted.
    """
    n_markers, noise_m = len(source), settings.noise_m
    weight = np.zeros((n_markers, n_markers))
    moves = np.empty((4, n_markers))
    for marker in range(n_markers):
        if not is_alone:
            weight[marker] = _learn_weights(tracks, source, marker)
        moves[:3, marker] = _learn_moves(tracks, source, marker, weight[marker], noise_m)
    chords = np.array([_learn_chord(tracks, source, pair, noise_m) for pair in range(n_markers - 1)]).reshape(-1, 2)
    return MarkerMotion(
        weight,
        moves[0],
        moves[1],
        moves[2],
        chords[:, 0].copy(),
        chords[:, 1].copy(),
        find_longest(settings),
        _measure_clutter(tracks, source),
    )


def find_longest(settings: SortSettings) -> Floats:
    """Return the largest distance between neighbours (k - 1,) that cable and noise allow."""
    return np.asarray(make_gates(settings).high_m[1:] + NOISE_SIGMAS * settings.noise_m)


def _sample(rows: Ints) -> Ints:
    return rows[:: max(1, len(rows) // SAMPLED)]


def _rows_apart(time_s: Floats, seen: Bools, lag_s: float, n_steps: int) -> list[Ints]:
    """Return n + 1 arrays of rows, seen and one lag apart; with a lag of 0 one row apart."""
    rows = [_sample(np.flatnonzero(seen))]
    for _ in range(n_steps):
        if lag_s > 0:
            later = np.searchsorted(time_s, time_s[rows[-1]] + lag_s * (1.0 - 1e-6))
            later = np.maximum(later, rows[-1] + 1)
        else:
            later = rows[-1] + 1
        inside = later < len(time_s)
        rows = [part[inside] for part in [*rows, later]]
        took_s = time_s[rows[-1]] - time_s[rows[-2]]
        good = seen[rows[-1]] & (took_s > 0)
        if lag_s > 0:
            good &= took_s <= max((1.0 + LARGEST_MISFIT) * lag_s, 2.0 * float(np.median(took_s)) if len(took_s) else 0)
        rows = [part[good] for part in rows]
    return rows


def _learn_weights(tracks: PointTracks, source: Ints, marker: int) -> Floats:
    weight = np.zeros(len(source))
    beside = [j for j in range(marker - REACH, marker + REACH + 1) if 0 <= j < len(source) and j != marker]
    seen = np.asarray((source[[marker, *beside]] >= 0).all(axis=0))
    early, late = _rows_apart(tracks.time_s, seen, LAG_S, 1)
    if len(early) < FEWEST:
        return weight
    moved = tracks.points_m[source[:, late][[marker, *beside]]] - tracks.points_m[source[:, early][[marker, *beside]]]
    own, others = moved[0].ravel(), moved[1:].reshape(len(beside), -1)
    square = others @ others.T
    square[np.diag_indices(len(beside))] += RIDGE * max(float(np.trace(square)), 1e-12)
    weight[beside] = np.linalg.solve(square, others @ own)
    return weight


def _relative(tracks: PointTracks, source: Ints, marker: int, weight: Floats, rows: Ints) -> Floats:
    place = tracks.points_m[source[marker, rows]].copy()
    for other in np.flatnonzero(weight):
        place -= weight[other] * tracks.points_m[source[other, rows]]
    return np.asarray(place)


def _learn_moves(
    tracks: PointTracks, source: Ints, marker: int, weight: Floats, noise_m: float
) -> tuple[float, float, float]:
    """Return jolt, variance of speed, and variance of noise."""
    time_s, seen = tracks.time_s, np.asarray((source[[marker, *np.flatnonzero(weight)]] >= 0).all(axis=0))
    rows = _rows_apart(time_s, seen, LAG_S, 2)
    if len(rows[0]) < FEWEST:
        return USUAL_JOLT, USUAL_SPEED_M_S**2, noise_m**2
    a, b, c = (_relative(tracks, source, marker, weight, part) for part in rows)
    before, after = (np.diff(time_s[np.stack(rows)], axis=0))[:, :, None]
    speed = (b - a) / before
    speed_m2_s2 = float(np.median(np.square(speed).sum(axis=1))) / MEDIAN_3D + noise_m**2 / LAG_S**2
    change = np.square((c - b) / after - speed).sum(axis=1) / (before + after)[:, 0]
    jolt = max(3.0 * float(np.quantile(change, HIGH)) / HIGH_3D, 1e-6)
    return jolt, speed_m2_s2, max(_learn_noise(tracks, source, marker, weight, seen, jolt), noise_m**2)


def _learn_noise(tracks: PointTracks, source: Ints, marker: int, weight: Floats, seen: Bools, jolt: float) -> float:
    """Return the variance of a marker's place by how far it lies from the middle between the frames beside it."""
    rows = _rows_apart(tracks.time_s, seen, 0.0, 2)
    if len(rows[0]) < FEWEST:
        return 0.0
    a, b, c = (_relative(tracks, source, marker, weight, part) for part in rows)
    before, after = np.diff(tracks.time_s[np.stack(rows)], axis=0)
    share = before / (before + after)
    off = np.square(b - a - share[:, None] * (c - a)).sum(axis=1) / MEDIAN_3D
    moved = jolt * (before + after) ** 3 * (share * (1.0 - share)) ** 2 / 3.0
    noises = (1.0 + share**2 + (1.0 - share) ** 2) * (1.0 + np.square(weight).sum())
    return float(np.median((off - moved) / noises))


def _learn_chord(tracks: PointTracks, source: Ints, pair: int, noise_m: float) -> tuple[float, float]:
    """Return how fast the variance of a distance between neighbours grows, and its noise."""
    seen = np.asarray((source[pair : pair + 2] >= 0).all(axis=0))
    early, late = _rows_apart(tracks.time_s, seen, LAG_S, 1)
    floor = 2.0 * noise_m**2
    if len(early) < FEWEST:
        return USUAL_CHORD_RATE, floor
    took_s = tracks.time_s[late] - tracks.time_s[early]
    grown = np.square(_chord(tracks, source, pair, late) - _chord(tracks, source, pair, early)) / took_s
    one, two, three = (_chord(tracks, source, pair, part) for part in _rows_apart(tracks.time_s, seen, 0.0, 2))
    noise = float(np.median(np.square(three - 2.0 * two + one))) / MEDIAN_1D / 6.0 * 2.0 if len(one) else 0.0
    return max(float(np.median(grown)) / MEDIAN_1D, 1e-8), max(noise, floor)


def _chord(tracks: PointTracks, source: Ints, pair: int, rows: Ints) -> Floats:
    step = tracks.points_m[source[pair + 1, rows]] - tracks.points_m[source[pair, rows]]
    return np.asarray(np.sqrt(np.square(step).sum(axis=1)))


def _measure_clutter(tracks: PointTracks, source: Ints) -> float:
    """Return the logarithm of the density of points without a label, close to those with one."""
    from bench.analysis.kernels.track_fits import count_close

    free = np.ones(len(tracks.points_m), dtype=bool)
    free[source[source >= 0]] = False
    rows = np.arange(len(tracks.time_s))[:: max(1, len(tracks.time_s) // SAMPLED)]
    n_close, n_seen = count_close(tracks.points_m, tracks.offsets, free, source, rows, CLUTTER_M)
    return float(np.log((n_close + 1.0) / (n_seen + 1.0) / (4.0 / 3.0 * np.pi * CLUTTER_M**3)))
