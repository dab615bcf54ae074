"""Rigid bodies in a frame: which points are theirs, and where their centre of gravity is (the paper's second case)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats, Floats32, Ints, chunks, frame_of_points, pad_points

__all__ = ["BodyMatch", "bridge_poses", "centre_of_labeled", "match_body", "rotate"]

MATCH_RADIUS_M = 0.004
"""A body's marker lies within this of where the body's pose puts it: mean errors of tracked bodies are 0.1 to 1 mm."""
LONGEST_BRIDGE_NS = 100_000_000
"""Through gaps of 0.09 s in the motion of a real gripper a spline puts nearly all of its markers within the radius."""


@dataclass(frozen=True, eq=False)
class BodyMatch:
    """One rigid body in F frames."""

    is_body: Bools
    """(N,): points that are the body's own markers."""
    centre_m: Floats
    """(F, 3): centre of gravity of the body's markers, lab frame; NaN where the body was not tracked."""


def rotate(quaternion_xyzw: Floats, vectors_m: Floats) -> Floats:
    """Turn vectors (m, 3) by each of F unit quaternions (x, y, z, w), from body to lab frame: (F, m, 3).

    A quaternion without length gives NaN.
    """
    length = np.linalg.norm(quaternion_xyzw, axis=1, keepdims=True)
    x, y, z, w = np.where(length > 0, quaternion_xyzw / np.where(length > 0, length, 1.0), np.nan).T
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.asarray(np.einsum("ijf,mj->fmi", matrix, vectors_m), dtype=np.float64)


def bridge_poses(time_ns: Ints, position_m: Floats, quaternion_xyzw: Floats) -> tuple[Floats, Floats]:
    """Return a body's poses with short gaps filled by a cubic spline through the known ones.

    A tracker that loses a body for some frames still lists those of its markers that it sees.

    Parameters
    ----------
    time_ns : (F,)
        Capture times, ascending.
    position_m, quaternion_xyzw : (F, 3), (F, 4)
        NaN where the body was not tracked; after the call, only in gaps longer than 0.1 s and at the ends.
    """
    pose = np.concatenate([position_m, quaternion_xyzw], axis=1)
    known = np.flatnonzero(np.isfinite(pose).all(axis=1))
    known = known[np.diff(time_ns[known], prepend=-1) > 0]
    if len(known) < 2:
        return position_m, quaternion_xyzw
    # a quaternion and its negative are the same turn
    kept = np.sign((quaternion_xyzw[known[1:]] * quaternion_xyzw[known[:-1]]).sum(axis=1))
    pose[known[1:], 3:] *= np.cumprod(np.where(kept < 0, -1.0, 1.0))[:, None]
    since_s = (time_ns - time_ns[known[0]]) * 1e-9
    gap_ns, place = np.diff(time_ns[known]), np.searchsorted(known, np.arange(len(pose)))
    inside = ~np.isfinite(pose).all(axis=1) & (place > 0) & (place < len(known))
    lost = np.flatnonzero(inside)[gap_ns[place[inside] - 1] <= LONGEST_BRIDGE_NS]
    pose[lost] = scipy.interpolate.CubicSpline(since_s[known], pose[known])(since_s[lost])
    return pose[:, :3], pose[:, 3:]


def match_body(
    points_m: Floats32, offsets: Ints, position_m: Floats, quaternion_xyzw: Floats, markers_m: Floats
) -> BodyMatch:
    """Find a rigid body's own markers among the points of each frame, by its pose.

    For trackers that list all markers without labels. Each of the body's markers takes the nearest point within 4 mm
    of where the pose puts it. The centre is the mean of the points where all markers are seen, else the mean of the
    places where they must be.

    Parameters
    ----------
    points_m, offsets
        The point lists of F frames.
    position_m : (F, 3)
        The body's position, lab frame; NaN where it was not tracked.
    quaternion_xyzw : (F, 4)
        Its orientation.
    markers_m : (m, 3)
        The body's markers in its own frame.
    """
    is_body = np.zeros(len(points_m), dtype=bool)
    centre = np.full((len(position_m), 3), np.nan)
    for start, stop in chunks(len(position_m)):
        frames = np.arange(start, stop)
        points, _ = pad_points(points_m, offsets, np.ones(len(points_m), dtype=bool), frames)
        expected = position_m[frames, None, :] + rotate(quaternion_xyzw[frames], markers_m)
        distance = np.linalg.norm(points[:, None] - expected[:, :, None], axis=3)
        distance = np.where(np.isfinite(distance), distance, np.inf)
        nearest = distance.argmin(axis=2)
        seen = distance.min(axis=2) <= MATCH_RADIUS_M
        row, _ = np.nonzero(seen)
        is_body[offsets[frames][row] + nearest[seen]] = True
        measured = points[np.arange(len(frames))[:, None], nearest]
        centre[frames] = np.where(seen.all(axis=1)[:, None], measured.mean(axis=1), expected.mean(axis=1))
    return BodyMatch(is_body, centre)


def centre_of_labeled(points_m: Floats32, offsets: Ints, is_body: Bools, fallback_m: Floats) -> Floats:
    """Return the mean (F, 3) of a body's labeled points, or `fallback_m` (F, 3) where some of them are hidden.

    Parameters
    ----------
    is_body : (N,)
        Points that the tracker labels as the body's.
    fallback_m : (F, 3)
        The centre by the body's pose, NaN where it was not tracked.
    """
    frame = frame_of_points(offsets)[is_body]
    count = np.bincount(frame, minlength=len(offsets) - 1)
    points = points_m[is_body].astype(np.float64)
    total = np.stack([np.bincount(frame, points[:, axis], minlength=len(count)) for axis in range(3)], axis=1)
    complete = (count == count.max(initial=0)) & (count > 0)
    return np.where(complete[:, None], total / np.maximum(count, 1)[:, None], fallback_m)
