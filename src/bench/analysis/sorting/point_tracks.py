"""Points of a recording joined in time into tracks, without knowing which marker they are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.analysis.arrays import Bools, Floats, Indices, Ints, frame_of_points
from bench.analysis.sorting.anchors import spread_frames
from bench.analysis.sorting.markers import PointFrames

__all__ = ["PointTracks", "leave_out_twins", "link_tracks"]

FASTEST_M_S = 3.0
"""No point of a cable is faster: robots that share their space with people move at 1 to 2 m/s, cables' loops faster."""
MEASURED_FRAMES = 300
TURN_S = 0.05
"""Acceleration is measured over steps of this: over a single one of 100 Hz, noise of 0.2 mm hides 10 m/s²."""
LARGEST_RATIO = 10.0
"""Of the usual acceleration: on a real cable, gates so wide refuse one link in a thousand."""
NOISE_RATIO = 3.0
"""Of the usual turn by noise, which is its median: normal noise stays below but once in ten thousand."""
LONGEST_S = 0.05
LONGEST_STEPS = 2.5
"""A track goes on over so long a gap, or over two missed frames of a slow tracker: longer ones are bridged from both
sides once the markers are known."""

SMALLEST_M = 5e-4
"""Noise of 0.2 mm puts a point so far from where two others lead."""
USUAL_M_S2 = 2.0
"""Acceleration of a cable on a robot, where a recording is too short to tell: 1.6 m/s² measured."""


@dataclass(frozen=True, eq=False)
class PointTracks:
    """N usable points of F frames in the order of time, and the T tracks they form."""

    points_m: Floats
    """(N, 3): lab frame."""
    slot: Indices
    """(N,): index of each point in its frame's list."""
    offsets: Ints
    """(F + 1,): points of row f are ``points_m[offsets[f]:offsets[f + 1]]``."""
    row: Ints
    """(N,): row of each point."""
    time_s: Floats
    """(F,): ascending, from the first row's."""
    frame: Ints
    """(F,): the frame that each row was."""
    track: Ints
    """(N,): the point's track, from 0."""
    begins: Ints
    """(T + 1,): points of track t are ``members[begins[t]:begins[t + 1]]``."""
    members: Ints
    """(N,)"""

    def __len__(self) -> int:
        """Return the number T of tracks."""
        return len(self.begins) - 1

    @cached_property
    def first(self) -> Ints:
        """(T,): row of each track's first point."""
        return self.row[self.members[self.begins[:-1]]]

    @cached_property
    def last(self) -> Ints:
        """(T,): row of each track's last point."""
        return self.row[self.members[self.begins[1:] - 1]]

    @cached_property
    def lasts_s(self) -> Floats:
        """(T,): time from each track's first to its last point."""
        return np.asarray(self.time_s[self.last] - self.time_s[self.first])

    def cut(self, begins: Bools) -> tuple[PointTracks, Ints]:
        """Let new tracks begin at some points (N,); return the tracks, and the old track (T,) of each of them."""
        starts = begins[self.members]
        starts[self.begins[:-1]] = True
        track = np.empty_like(self.track)
        track[self.members] = np.cumsum(starts) - 1
        old = self.track[self.members[starts]]
        return replace(self, track=track, begins=np.append(np.flatnonzero(starts), len(starts))), old

    def find_next(self, some: Bools) -> Bools:
        """Return the points (N,) that come next in the tracks after some points (N,)."""
        following = np.zeros_like(some)
        following[self.members[1:]] = some[self.members[:-1]]
        return following


def link_tracks(frames: PointFrames) -> PointTracks:
    """Join the usable points of all frames into tracks; all of them have a place.

    From frame to frame, mutual nearest neighbours of where constant speed leads are joined; where a second candidate
    is near as well, none is. Gates come from the recording: its usual acceleration and noise, and the time between
    frames.
    """
    from bench.analysis.kernels.point_links import link_points

    order = np.argsort(frames.time_ns, kind="stable")
    if (order[1:] < order[:-1]).any():
        frames = frames.take(order)
    time_s = np.asarray((frames.time_ns - frames.time_ns[:1]) * 1e-9)
    kept = np.flatnonzero(frames.usable)
    row, points = frame_of_points(frames.offsets)[kept], frames.points_m[kept].astype(np.float64)
    slot = (kept - frames.offsets[row]).astype(np.int16)
    offsets = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(frames)))])
    acceleration, noise, step_s = _measure_turns(points, offsets, time_s)
    longest_s = max(LONGEST_S, LONGEST_STEPS * step_s)
    track = link_points(
        points, offsets, time_s, LARGEST_RATIO * acceleration, NOISE_RATIO * noise, FASTEST_M_S, longest_s
    )
    members = np.argsort(track, kind="stable")
    begins = np.concatenate([[0], np.cumsum(np.bincount(track))])
    return PointTracks(points, slot, offsets, row, time_s, order, track, begins, members)


def leave_out_twins(frames: PointFrames) -> PointFrames:
    """Return the frames without points that have no place, or that a frame lists twice."""
    from bench.analysis.kernels.point_links import find_twins

    usable = frames.usable & np.isfinite(frames.points_m).all(axis=1)
    return replace(frames, usable=usable & ~find_twins(frames.points_m, frames.offsets))


def _measure_turns(points_m: Floats, offsets: Ints, time_s: Floats) -> tuple[float, float, float]:
    """Return the usual acceleration (m/s²), turn by noise alone (m), and time between frames (s)."""
    steps = np.diff(time_s)
    step_s = float(np.median(steps[steps > 0])) if (steps > 0).any() else TURN_S
    stride = max(1, round(TURN_S / step_s))
    turn, _ = _usual_turn(points_m, offsets, time_s, 1)
    _, acceleration = _usual_turn(points_m, offsets, time_s, stride)
    return acceleration, float(np.sqrt(max(turn**2 - (acceleration * step_s**2) ** 2, SMALLEST_M**2))), step_s


def _usual_turn(points_m: Floats, offsets: Ints, time_s: Floats, stride: int) -> tuple[float, float]:
    from bench.analysis.kernels.point_links import measure_turns

    middle = spread_frames(stride, len(time_s) - stride, MEASURED_FRAMES)
    turns = measure_turns(points_m, offsets, time_s, middle, stride, FASTEST_M_S)
    turns = turns[np.isfinite(turns[:, 0])]
    if not len(turns):
        return SMALLEST_M, USUAL_M_S2
    return float(np.median(turns[:, 0])), float(np.median(turns[:, 0] / turns[:, 1]))
