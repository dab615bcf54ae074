"""Where a hidden marker must be, from its own motion before and after."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.analysis.kernels.compiling import compiled

__all__ = ["bridge_motion", "filter_motion", "find_neighbours_in_time", "measure_steps"]

LASTING_S = 0.05
"""Seen from one side only, a cable's acceleration lasts, and leads it away faster than noise does."""

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


@compiled
def find_neighbours_in_time(seen: Bools) -> tuple[Ints, Ints]:
    """Return for each frame (F,) the last seen one before it and the first seen one after it; -1 without any."""
    n_frames = len(seen)
    before, after = np.full(n_frames, -1, dtype=np.int64), np.full(n_frames, -1, dtype=np.int64)
    for frame in range(1, n_frames):
        before[frame] = frame - 1 if seen[frame - 1] else before[frame - 1]
    for frame in range(n_frames - 2, -1, -1):
        after[frame] = frame + 1 if seen[frame + 1] else after[frame + 1]
    return before, after


@compiled
def filter_motion(
    place_m: Floats,
    variance_m2: Floats,
    seen: Bools,
    time_s: Floats,
    jolt_m2_s3: float,
    speed_m2_s2: float,
    is_onward: bool,
) -> Floats:
    """Return the state (F, 9) after each seen frame: place, speed, and an axis' variances (place, both, speed).

    A Kalman filter of a place (F, 3) whose acceleration is white noise of density `jolt_m2_s3`, run from the first
    frame to the last, or from the last to the first. `speed_m2_s2` is the variance of speed before anything is seen.
    Rows of frames not seen are NaN.
    """
    n_frames = len(time_s)
    state = np.full((n_frames, 9), np.nan)
    x, y, z, u, v, w = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    pp, pv, vv = -1.0, 0.0, 0.0
    then_s = 0.0
    for step in range(n_frames):
        frame = step if is_onward else n_frames - 1 - step
        if not seen[frame]:
            continue
        noise = variance_m2[frame]
        if pp < 0.0:
            x, y, z = place_m[frame, 0], place_m[frame, 1], place_m[frame, 2]
            pp, vv = noise, speed_m2_s2
        else:
            dt = abs(time_s[frame] - then_s)
            x, y, z = x + u * dt, y + v * dt, z + w * dt
            pp += 2.0 * dt * pv + dt * dt * vv + jolt_m2_s3 * dt * dt * dt / 3.0
            pv += dt * vv + jolt_m2_s3 * dt * dt / 2.0
            vv += jolt_m2_s3 * dt
            gain, drift = pp / (pp + noise), pv / (pp + noise)
            dx, dy, dz = place_m[frame, 0] - x, place_m[frame, 1] - y, place_m[frame, 2] - z
            x, y, z = x + gain * dx, y + gain * dy, z + gain * dz
            u, v, w = u + drift * dx, v + drift * dy, w + drift * dz
            vv -= drift * pv
            pv *= 1.0 - gain
            pp *= 1.0 - gain
        then_s = time_s[frame]
        row = state[frame]
        row[0], row[1], row[2], row[3], row[4], row[5] = x, y, z, u, v, w
        row[6], row[7], row[8] = pp, pv, vv
    return state


@compiled
def bridge_motion(
    onward: Floats,
    back: Floats,
    before: int,
    after: int,
    time_s: Floats,
    now_s: float,
    jolt_m2_s3: float,
    place_m: Floats,
) -> float:
    """Put the place between two seen frames into `place_m` (3,), and return its variance on each axis.

    `before` and `after` are rows of `onward` and `back` as `filter_motion` returns them, -1 where there is none; with
    neither the place is NaN and the variance infinite.
    """
    if before < 0 and after < 0:
        place_m[:] = np.nan
        return np.inf
    if before < 0:
        before_s, ahead = time_s[after], back[after]
    else:
        before_s, ahead = time_s[before], onward[before]
    dt = abs(now_s - before_s)
    x, y, z = ahead[0] + ahead[3] * dt, ahead[1] + ahead[4] * dt, ahead[2] + ahead[5] * dt
    pp = ahead[6] + 2.0 * dt * ahead[7] + dt * dt * ahead[8] + jolt_m2_s3 * dt * dt * dt / 3.0
    if before < 0 or after < 0:
        place_m[0], place_m[1], place_m[2] = x, y, z
        return float(pp + jolt_m2_s3 * dt * dt * dt / 3.0 * dt / LASTING_S)
    pv = ahead[7] + dt * ahead[8] + jolt_m2_s3 * dt * dt / 2.0
    vv = ahead[8] + jolt_m2_s3 * dt
    # from behind comes a second account of place and speed, its speed pointing back in time
    behind = back[after]
    dt = time_s[after] - now_s
    spp = pp + behind[6] + 2.0 * dt * behind[7] + dt * dt * behind[8] + jolt_m2_s3 * dt * dt * dt / 3.0
    spv = pv - (behind[7] + dt * behind[8] + jolt_m2_s3 * dt * dt / 2.0)
    svv = vv + behind[8] + jolt_m2_s3 * dt
    determinant = spp * svv - spv * spv
    gain, drift = (pp * svv - pv * spv) / determinant, (pv * spp - pp * spv) / determinant
    place_m[0] = x + gain * (behind[0] + behind[3] * dt - x) - drift * (behind[3] + ahead[3])
    place_m[1] = y + gain * (behind[1] + behind[4] * dt - y) - drift * (behind[4] + ahead[4])
    place_m[2] = z + gain * (behind[2] + behind[5] * dt - z) - drift * (behind[5] + ahead[5])
    return float(max(pp - gain * pp - drift * pv, 0.0))


@compiled
def measure_steps(
    onward: Floats,
    back: Floats,
    place_m: Floats,
    variance_m2: Floats,
    before: Ints,
    seen: Bools,
    time_s: Floats,
    jolt_m2_s3: float,
) -> Floats:
    """Return how far each seen row (F,) is from where the motion before leads, or the row before from that after.

    The smaller of both, square over variance: a single point that is off makes one of them large, a change for good
    both. 0 where there is no row before.
    """
    steps, there = np.zeros(len(seen)), np.zeros(3)
    for row in range(len(seen)):
        early = before[row]
        if not seen[row] or early < 0:
            continue
        smallest = np.inf
        for now, state_before, state_after in ((row, early, -1), (early, -1, row)):
            variance = bridge_motion(onward, back, state_before, state_after, time_s, time_s[now], jolt_m2_s3, there)
            square = 0.0
            for axis in range(3):
                square += (place_m[now, axis] - there[axis]) ** 2
            smallest = min(smallest, square / (variance + variance_m2[now]))
        steps[row] = smallest
    return steps
