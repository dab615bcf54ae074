"""Joins a tracker's points from frame to frame without knowing which marker they are."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.analysis.kernels.compiling import compiled

__all__ = ["find_twins", "link_points", "measure_turns"]

Floats = npt.NDArray[np.float64]
Floats32 = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]

TOO_ALIKE = 3.0
"""A second candidate nearer than this times the distance of the first makes a link a guess."""
NEAR_M2 = 1e-6
ROOM = 8
"""Tracks that are followed at a time, for each point of a frame: those hidden for a moment, and ghosts'."""
REACH, SEEN, TURN = 6, 7, 8
"""Columns of a live track after its place and speed: what its speed may be off by, when it was last seen, and the
acceleration (3) with which it turned then, 0 where that is no more than noise."""
START_SHARE = 0.5
START_SPEED_M_S = 0.1
"""What is not known of a new track's speed: half of the speed that its neighbours have, and this."""


@compiled
def find_twins(points_m: Floats32, offsets: Ints) -> Bools:
    """Return which points (N,) lie exactly where an earlier one of their frame does."""
    is_twin = np.zeros(len(points_m), dtype=np.bool_)
    for frame in range(len(offsets) - 1):
        for b in range(offsets[frame], offsets[frame + 1]):
            for a in range(offsets[frame], b):
                if points_m[a, 0] == points_m[b, 0] and points_m[a, 1] == points_m[b, 1]:
                    is_twin[b] |= points_m[a, 2] == points_m[b, 2]
    return is_twin


@compiled
def measure_turns(
    points_m: Floats, offsets: Ints, time_s: Floats, middle: Ints, stride: int, speed_m_s: float
) -> Floats:
    """Return how far the points of some frames turn from a straight line, and per which square of time, (n, 2).

    For points a, b, c of a frame, the one `stride` frames earlier and the one as much later: the smallest
    ``|c - b - (b - a) after / before|`` over all a and c that the cap on speed allows, and the time squared by which an
    acceleration is multiplied in that. NaN where the cap allows none. Points (N, 3), offsets (F + 1,), time (F,),
    frames (C,).
    """
    total = 0
    for frame in middle:
        total += offsets[frame + 1] - offsets[frame]
    turns = np.full((total, 2), np.nan)
    row = -1
    for frame in middle:
        earlier, later = frame - stride, frame + stride
        before, after = time_s[frame] - time_s[earlier], time_s[later] - time_s[frame]
        for b in range(offsets[frame], offsets[frame + 1]):
            row += 1
            if before <= 0.0 or after <= 0.0:
                continue
            smallest = np.inf
            for a in range(offsets[earlier], offsets[earlier + 1]):
                x, y, z = (
                    points_m[b, 0] - points_m[a, 0],
                    points_m[b, 1] - points_m[a, 1],
                    points_m[b, 2] - points_m[a, 2],
                )
                if x * x + y * y + z * z > (speed_m_s * before) ** 2:
                    continue
                ratio = after / before
                x, y, z = points_m[b, 0] + x * ratio, points_m[b, 1] + y * ratio, points_m[b, 2] + z * ratio
                for c in range(offsets[later], offsets[later + 1]):
                    u, v, w = points_m[c, 0] - x, points_m[c, 1] - y, points_m[c, 2] - z
                    smallest = min(smallest, u * u + v * v + w * w)
            if smallest < np.inf:
                turns[row, 0] = np.sqrt(smallest)
                turns[row, 1] = after * (before + after) / 2.0
    return turns


@compiled
def link_points(
    points_m: Floats,
    offsets: Ints,
    time_s: Floats,
    acceleration_m_s2: float,
    noise_m: float,
    speed_m_s: float,
    longest_s: float,
) -> Ints:
    """Return the track (N,) of each point: mutual nearest neighbours of the places where constant speed leads.

    Parameters
    ----------
    points_m : (N, 3)
    offsets : (F + 1,)
    time_s : (F,)
        Ascending.
    acceleration_m_s2, noise_m : float
        A point lies within ``acceleration dt² + noise`` of where its track leads with constant speed, or going on with
        the turn that it has just made.
    speed_m_s : float
        No point is faster.
    longest_s : float
        A track that saw no point for longer ends.
    """
    most = 0
    for frame in range(len(offsets) - 1):
        most = max(most, offsets[frame + 1] - offsets[frame])
    track, room = np.full(len(points_m), -1, dtype=np.int64), ROOM * (most + 1)
    live, name = np.zeros((room, 11)), np.zeros(room, dtype=np.int64)
    nearest, distance = np.zeros(room, dtype=np.int64), np.zeros((room, 2))
    owner, claim = np.zeros(most, dtype=np.int64), np.zeros((most, 2))
    n_live, n_names = 0, 0
    for frame in range(len(offsets) - 1):
        now, points = time_s[frame], points_m[offsets[frame] : offsets[frame + 1]]
        n_old = _end_tracks(live, name, n_live, now - longest_s, room - most)
        owner[:], claim[:] = -1, np.inf
        for i in range(n_old):
            dt = now - live[i, SEEN]
            gate = min(acceleration_m_s2 * dt * dt + live[i, REACH] * dt, speed_m_s * dt) + noise_m
            nearest[i] = _find_nearest(points, live[i], dt, gate, i, distance[i], owner, claim)
        n_live = n_old
        for p in range(len(points)):
            i = owner[p]  # the track that comes nearest to the point
            limit = max(TOO_ALIKE * claim[p, 0], noise_m)
            if i >= 0 and nearest[i] == p and distance[i, 1] > limit and claim[p, 1] > limit:
                _follow(live[i], points[p], now, noise_m)
            else:
                i, owner[p] = n_live, -1
                name[i] = n_names
                live[i, 0], live[i, 1], live[i, 2], live[i, SEEN] = points[p, 0], points[p, 1], points[p, 2], now
                n_live, n_names = n_live + 1, n_names + 1
            track[offsets[frame] + p] = name[i]
        for i in range(n_old):
            if live[i, SEEN] < now and nearest[i] >= 0 and owner[nearest[i]] < 0:
                live[i, SEEN] = -np.inf  # else it and the track that begins there would refuse each other's points
        for i in range(n_old, n_live):
            _start(live, n_old, i, now, speed_m_s)
    return track


@compiled
def _end_tracks(live: Floats, name: Ints, n_live: int, since_s: float, most: int) -> int:
    """Keep the tracks seen since some time, the newest of them where there is no room; return how many."""
    kept = 0
    for i in range(n_live):
        if live[i, SEEN] >= since_s and n_live - i <= most:
            for c in range(live.shape[1]):
                live[kept, c] = live[i, c]
            name[kept] = name[i]
            kept += 1
    return kept


@compiled
def _find_nearest(
    points: Floats, track: Floats, dt: float, gate: float, index: int, distance: Floats, owner: Ints, claim: Floats
) -> int:
    """Return the point nearest to where a track leads, straight on or still turning, within three gates, or -1.

    `distance` gets its distance and the next one's. Points within the gate remember in `owner` which track came
    nearest, and in `claim` its distance and the next one's.
    """
    x, y, z = track[0] + track[3] * dt, track[1] + track[4] * dt, track[2] + track[5] * dt
    u, v, w = track[TURN] * dt * dt, track[TURN + 1] * dt * dt, track[TURN + 2] * dt * dt
    nearest, distance[0], distance[1] = -1, np.inf, np.inf
    for p in range(len(points)):
        dx = points[p, 0] - x
        if min(abs(dx), abs(dx - u)) > TOO_ALIKE * gate:
            continue
        dy, dz = points[p, 1] - y, points[p, 2] - z
        apart = np.sqrt(min(dx * dx + dy * dy + dz * dz, (dx - u) ** 2 + (dy - v) ** 2 + (dz - w) ** 2))
        if apart > TOO_ALIKE * gate:
            continue
        if apart < distance[0]:
            nearest, distance[0], distance[1] = p, apart, distance[0]
        elif apart < distance[1]:
            distance[1] = apart
        if apart < min(claim[p, 0], gate):
            owner[p], claim[p, 0], claim[p, 1] = index, apart, claim[p, 0]
        elif apart < min(claim[p, 1], gate):
            claim[p, 1] = apart
    return nearest


@compiled
def _follow(track: Floats, point: Floats, now: float, noise_m: float) -> None:
    """Let a track go on with a point."""
    dt = now - track[SEEN]
    if dt > 0.0:
        square = 0.0
        for axis in range(3):
            speed = (point[axis] - track[axis]) / dt
            track[TURN + axis] = (speed - track[3 + axis]) / dt
            track[3 + axis] = speed
            square += track[TURN + axis] ** 2
        if track[REACH] > 0.0 or square * dt**4 < noise_m * noise_m:
            track[TURN : TURN + 3] = 0.0
        track[REACH] = 0.0
    track[0], track[1], track[2], track[SEEN] = point[0], point[1], point[2], now


@compiled
def _start(live: Floats, n_old: int, new: int, now: float, speed_m_s: float) -> None:
    """Give a new track the speed of the tracks beside it, until it shows its own."""
    u, v, w, total = 0.0, 0.0, 0.0, 0.0
    for j in range(n_old):
        if live[j, REACH] == 0.0 and live[j, SEEN] == now:
            x, y, z = live[new, 0] - live[j, 0], live[new, 1] - live[j, 1], live[new, 2] - live[j, 2]
            weight = 1.0 / (x * x + y * y + z * z + NEAR_M2) ** 2
            total += weight
            u, v, w = u + weight * live[j, 3], v + weight * live[j, 4], w + weight * live[j, 5]
    live[new, 3:6], live[new, REACH], live[new, TURN:] = 0.0, speed_m_s, 0.0
    if total > 0.0:
        live[new, 3], live[new, 4], live[new, 5] = u / total, v / total, w / total
        pace = np.sqrt(u * u + v * v + w * w) / total
        live[new, REACH] = START_SHARE * pace + START_SPEED_M_S
