"""How well points without a label fit the places where hidden markers must be."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.analysis.kernels.compiling import compiled
from bench.analysis.kernels.motion_bridges import bridge_motion

__all__ = [
    "count_close",
    "estimate_places",
    "fit_free_tracks",
    "fit_labeled",
    "follow_neighbours",
    "label_tracks",
]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

WORST, BEST = -30.0, 8.0
"""Bounds of a point's score, so that none outweighs all others of its track."""
LARGEST_M2 = 0.01
"""A place known worse than ±0.1 m tells nothing that the chain does not know better."""
CHORD_S = 1.0
"""Chords longer ago say no more than the cable's spacing."""
UNKNOWN_M2 = 1.0
WIDE_SHARE, WIDE = 0.02, 4.0
"""In one case of fifty the place of a marker hidden for long is known only half as well as its motion says: on a real
cable, of places in the middle of gaps of 0.1 to 0.5 s one in a hundred is 3 to 5 standard deviations off."""
JUMP_SHARE, JUMP_M2 = 1e-3, 4e-6
"""One frame in a thousand has a marker a few millimetres off, with 0.1 mm of noise elsewhere: on a real cable."""
JUMP_FRAMES = 5
"""Markers jump for one frame: in a longer gap, a point a few millimetres off is a ghost that rides along."""
LOG_2PI = 1.8378770664093453


@compiled
def _log_density(square_m2: float, variance_m2: float, n_axes: int) -> float:
    """Return the log density of being as far off as that, where some places are known worse than they say."""
    usual = (1.0 - WIDE_SHARE) * np.exp(-0.5 * square_m2 / variance_m2)
    wide = WIDE_SHARE * np.exp(-0.5 * square_m2 / (WIDE * variance_m2)) / WIDE ** (0.5 * n_axes)
    return float(np.log(usual + wide + 1e-30) - 0.5 * n_axes * (LOG_2PI + np.log(variance_m2)))


@compiled
def follow_neighbours(
    points_m: Floats, source: Ints, place_m: Floats, variance_m2: Floats, weight: Floats, marker: int
) -> tuple[Floats, Floats, Floats]:
    """Return where the markers beside it put a marker, the variance of that, and by how much it is elsewhere.

    Points (N, 3), their rows `source` (k, F), places (k, F, 3) and variances (k, F), weights (k,) of the markers
    beside it. Returned are (F, 3), (F,) and (F, 3).
    """
    n_frames = source.shape[1]
    base, spread, apart = np.zeros((n_frames, 3)), np.zeros(n_frames), np.zeros((n_frames, 3))
    for j in range(len(weight)):
        if weight[j] == 0.0:
            continue
        for frame in range(n_frames):
            base[frame, 0] += weight[j] * place_m[j, frame, 0]
            base[frame, 1] += weight[j] * place_m[j, frame, 1]
            base[frame, 2] += weight[j] * place_m[j, frame, 2]
            spread[frame] += weight[j] * weight[j] * variance_m2[j, frame]
    for frame in range(n_frames):
        point = source[marker, frame]
        if point >= 0:
            for axis in range(3):
                apart[frame, axis] = points_m[point, axis] - base[frame, axis]
    return base, spread, apart


@compiled
def estimate_places(
    points_m: Floats,
    source: Ints,
    marker: int,
    onward: Floats,
    back: Floats,
    before: Ints,
    after: Ints,
    time_s: Floats,
    jolt_m2_s3: float,
    base_m: Floats,
    spread_m2: Floats,
    noise_m2: float,
    place_m: Floats,
    variance_m2: Floats,
) -> None:
    """Write where one marker is, (F, 3) and (F,): measured where it is seen, bridged elsewhere."""
    now = np.zeros(3)
    for frame in range(len(time_s)):
        point = source[marker, frame]
        if point >= 0:
            for c in range(3):
                place_m[frame, c] = points_m[point, c]
            variance_m2[frame] = noise_m2
        else:
            own = bridge_motion(onward, back, before[frame], after[frame], time_s, time_s[frame], jolt_m2_s3, now)
            for c in range(3):
                place_m[frame, c] = now[c] + base_m[frame, c]
            variance_m2[frame] = own + spread_m2[frame]


@compiled
def _chord(points_m: Floats, a: int, b: int) -> float:
    x, y, z = points_m[a, 0] - points_m[b, 0], points_m[a, 1] - points_m[b, 1], points_m[a, 2] - points_m[b, 2]
    return float(np.sqrt(x * x + y * y + z * z))


@compiled
def _find_chord(source: Ints, i: int, j: int, start: int, step: int, time_s: Floats) -> int:
    """Return the nearest frame from `start` on in which both markers are seen, -1 if there is none within a second."""
    frame = start
    while 0 <= frame < len(time_s) and abs(time_s[frame] - time_s[start]) <= CHORD_S:
        if source[i, frame] >= 0 and source[j, frame] >= 0:
            return frame
        frame += step
    return -1


@compiled
def _score_chord(
    points_m: Floats,
    source: Ints,
    time_s: Floats,
    marker: int,
    other: int,
    point: int,
    frame: int,
    first: int,
    last: int,
    rate_m2_s: float,
    noise_m2: float,
    variance_m2: float,
) -> float:
    """Return how much better the distance to a neighbour fits a marker than any point of that place."""
    i = _find_chord(source, marker, other, first - 1, -1, time_s)
    j = _find_chord(source, marker, other, last + 1, 1, time_s)
    if i < 0 and j < 0:
        return 0.0
    if i < 0 or j < 0:
        known = max(i, j)
        expected = _chord(points_m, source[marker, known], source[other, known])
        spread = rate_m2_s * abs(time_s[known] - time_s[frame])
    else:
        span = max(time_s[j] - time_s[i], 1e-9)
        share = (time_s[frame] - time_s[i]) / span
        earlier = _chord(points_m, source[marker, i], source[other, i])
        later = _chord(points_m, source[marker, j], source[other, j])
        expected = earlier + share * (later - earlier)
        spread = rate_m2_s * span * share * (1.0 - share)
    spread += noise_m2
    error = (_chord(points_m, point, source[other, frame]) - expected) ** 2
    return _log_density(error, spread, 1) - _log_density(error, spread + variance_m2, 1)


@compiled
def _score_point(
    points_m: Floats,
    source: Ints,
    time_s: Floats,
    marker: int,
    point: int,
    frame: int,
    first: int,
    last: int,
    place_m: Floats,
    variance_m2: float,
    log_clutter: float,
    chord_rate: Floats,
    chord_noise: Floats,
    longest_m: Floats,
) -> float:
    """Return the log of how much likelier a point is the marker than a ghost; 0 where nothing tells."""
    if not variance_m2 < UNKNOWN_M2:
        return 0.0
    square = 0.0
    for axis in range(3):
        square += (points_m[point, axis] - place_m[axis]) ** 2
    variance_m2 = min(variance_m2, LARGEST_M2)
    score = _log_density(square, variance_m2, 3)
    # a jump makes the distances to the neighbours wrong as well: it is weighed against them all, once
    jump = np.log(JUMP_SHARE) if last - first < JUMP_FRAMES else 2.0 * np.log(JUMP_SHARE)
    jump -= 1.5 * (LOG_2PI + np.log(variance_m2 + JUMP_M2)) + 0.5 * square / (variance_m2 + JUMP_M2)
    if max(score, jump) - log_clutter < WORST / 2.0:
        return WORST
    for other in (marker - 1, marker + 1):
        if 0 <= other < len(source) and source[other, frame] >= 0:
            pair = min(marker, other)
            if _chord(points_m, point, source[other, frame]) > longest_m[pair]:
                return WORST
            score += _score_chord(
                points_m,
                source,
                time_s,
                marker,
                other,
                point,
                frame,
                first,
                last,
                chord_rate[pair],
                chord_noise[pair],
                variance_m2,
            )
    larger = max(score, jump)
    return float(max(larger + np.log(np.exp(score - larger) + np.exp(jump - larger)) - log_clutter, WORST))


@compiled
def fit_free_tracks(
    points_m: Floats,
    offsets: Ints,
    track: Ints,
    is_free: Bools,
    source: Ints,
    marker: int,
    before: Ints,
    after: Ints,
    time_s: Floats,
    place_m: Floats,
    variance_m2: Floats,
    noise_m2: float,
    log_clutter: float,
    chord_rate: Floats,
    chord_noise: Floats,
    longest_m: Floats,
    n_tracks: int,
) -> tuple[Floats, Floats, Floats, Ints]:
    """Return for each track the sum of the scores of its free points where the marker is hidden, and their number.

    Between them stand the sum of the scores bounded above, so that one that does not fit outweighs three that do, and
    the best score.
    """
    total, bounded, best = np.zeros(n_tracks), np.zeros(n_tracks), np.full(n_tracks, -np.inf)
    count = np.zeros(n_tracks, dtype=np.int64)
    n_frames = len(time_s)
    for frame in range(n_frames):
        if source[marker, frame] >= 0:
            continue
        last = after[frame] - 1 if after[frame] >= 0 else n_frames - 1
        for point in range(offsets[frame], offsets[frame + 1]):
            if is_free[point]:
                score = _score_point(
                    points_m,
                    source,
                    time_s,
                    marker,
                    point,
                    frame,
                    before[frame] + 1,
                    last,
                    place_m[frame],
                    variance_m2[frame] + noise_m2,
                    log_clutter,
                    chord_rate,
                    chord_noise,
                    longest_m,
                )
                total[track[point]] += score
                bounded[track[point]] += min(score, BEST)
                best[track[point]] = max(best[track[point]], score)
                count[track[point]] += 1
    return total, bounded, best, count


@compiled
def measure_jumps(
    apart_m: Floats, before: Ints, after: Ints, seen: Bools, time_s: Floats, variance_m2: Floats, jolt_m2_s3: float
) -> Floats:
    """Return how far seen rows (F,) lie off the line between those before and after them: square over variance.

    Places `apart_m` (F, 3) relative to the markers beside it, and the variances (F,) of that. 0 at both ends, where
    there is no such line.
    """
    jumps = np.zeros(len(seen))
    for row in range(len(seen)):
        i, j = before[row], after[row]
        if not seen[row] or i < 0 or j < 0:
            continue
        span = max(time_s[j] - time_s[i], 1e-9)
        share = (time_s[row] - time_s[i]) / span
        square = 0.0
        for axis in range(3):
            line = apart_m[i, axis] + share * (apart_m[j, axis] - apart_m[i, axis])
            square += (apart_m[row, axis] - line) ** 2
        usual = variance_m2[row] + (1.0 - share) ** 2 * variance_m2[i] + share * share * variance_m2[j]
        jumps[row] = square / (usual + jolt_m2_s3 * span * (span * share * (1.0 - share)) ** 2 / 3.0)
    return jumps


@compiled
def fit_labeled(
    points_m: Floats,
    source: Ints,
    marker: int,
    first: Ints,
    last: Ints,
    onward: Floats,
    back: Floats,
    before: Ints,
    after: Ints,
    time_s: Floats,
    jolt_m2_s3: float,
    base_m: Floats,
    spread_m2: Floats,
    noise_m2: float,
    log_clutter: float,
    chord_rate: Floats,
    chord_noise: Floats,
    longest_m: Floats,
) -> Floats:
    """Return the scores (F,) of a marker's own points, as if it were hidden from `first` to `last` (F,) of each frame.

    NaN where it has no point, or `first` is -1.
    """
    scores, now = np.full(len(time_s), np.nan), np.zeros(3)
    for frame in range(len(time_s)):
        point = source[marker, frame]
        if point < 0 or first[frame] < 0:
            continue
        i, j = before[first[frame]], after[last[frame]]
        own = bridge_motion(onward, back, i, j, time_s, time_s[frame], jolt_m2_s3, now)
        scores[frame] = _score_point(
            points_m,
            source,
            time_s,
            marker,
            point,
            frame,
            first[frame],
            last[frame],
            now + base_m[frame],
            own + spread_m2[frame] + noise_m2,
            log_clutter,
            chord_rate,
            chord_noise,
            longest_m,
        )
    return scores


@compiled
def label_tracks(
    chosen: Ints, marker: Ints, begins: Ints, rows: Ints, frame: Ints, share: float, source: Ints
) -> Bools:
    """Give tracks to markers, in the order of `chosen`, and return which of them were taken.

    Parameters
    ----------
    chosen, marker : (n,)
        Tracks, and the marker of each.
    begins, rows : (T + 1,), (N,)
        Points of track t are ``rows[begins[t]:begins[t + 1]]``.
    frame : (N,)
        Frame of each point.
    share : float
        A marker has a point already in the other frames of the track; with less than this share free it is not taken.
    source : (k, F)
        Is written: the point of each marker, -1 without.
    """
    taken = np.zeros(len(chosen), dtype=np.bool_)
    for i in range(len(chosen)):
        first, stop, m = begins[chosen[i]], begins[chosen[i] + 1], marker[i]
        n_free = 0
        for row in range(first, stop):
            n_free += source[m, frame[rows[row]]] < 0
        if n_free == 0 or n_free < share * (stop - first):
            continue
        taken[i] = True
        for row in range(first, stop):
            if source[m, frame[rows[row]]] < 0:
                source[m, frame[rows[row]]] = rows[row]
    return taken


@compiled
def count_close(
    points_m: Floats, offsets: Ints, is_free: Bools, source: Ints, rows: Ints, radius_m: float
) -> tuple[int, int]:
    """Return how many free points lie close to labeled ones in some frames, and how many of those there are."""
    n_close, n_seen = 0, 0
    for frame in rows:
        for marker in range(len(source)):
            own = source[marker, frame]
            if own < 0:
                continue
            n_seen += 1
            for point in range(offsets[frame], offsets[frame + 1]):
                if is_free[point] and _chord(points_m, own, point) < radius_m:
                    n_close += 1
    return n_close, n_seen
