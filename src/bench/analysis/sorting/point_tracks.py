"""Points of a recording joined in time into tracks, without knowing which marker they are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.analysis.arrays import Bools, Floats, Indices, Ints, frame_of_points
from bench.analysis.sorting.anchors import spread_frames
from bench.analysis.sorting.markers import PointFrames

__all__ = ["LinkGates", "PointTracks", "leave_out_twins", "link_tracks", "measure_gates"]

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
    """N usable points of F frames in order of time, which are the rows, and the T tracks they form."""

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


@dataclass(frozen=True)
class LinkGates:
    """How far from where its track leads a point may be."""

    acceleration_m_s2: float
    """The recording's usual one."""
    noise_m: float
    """Usual turn by noise alone."""
    longest_s: float
    """Gap over which a track goes on."""


def measure_gates(frames: PointFrames, order: Ints) -> LinkGates:
    """Measure in some of the frames, which are in order of time as `order` (F,) has them, how points move."""
    steps = np.diff(frames.time_ns[order]) * 1e-9
    step_s = float(np.median(steps[steps > 0])) if (steps > 0).any() else TURN_S
    stride = max(1, round(TURN_S / step_s))
    turn, _ = _usual_turn(frames, order, 1)
    _, acceleration = _usual_turn(frames, order, stride)
    noise_m = float(np.sqrt(max(turn**2 - (acceleration * step_s**2) ** 2, SMALLEST_M**2)))
    return LinkGates(acceleration, noise_m, max(LONGEST_S, LONGEST_STEPS * step_s))


def link_tracks(frames: PointFrames, gates: LinkGates) -> PointTracks:
    """Join the usable points of all frames, in order of time, into tracks; all of them have a place.

    From frame to frame, mutual nearest neighbours of where constant speed leads are joined; where a second candidate
    is near as well, none is. Gates come from the recording: its usual acceleration and noise, and the time between
    frames.
    """
    from bench.analysis.kernels.point_links import link_points

    time_s = _seconds(frames.time_ns)
    points, offsets, kept = _list_usable(frames)
    row = frame_of_points(offsets)
    slot = (kept - frames.offsets[row]).astype(np.int16)
    track = link_points(
        points,
        offsets,
        time_s,
        LARGEST_RATIO * gates.acceleration_m_s2,
        NOISE_RATIO * gates.noise_m,
        FASTEST_M_S,
        gates.longest_s,
    )
    members = np.argsort(track, kind="stable")
    begins = np.concatenate([[0], np.cumsum(np.bincount(track))])
    return PointTracks(points, slot, offsets, row, time_s, track, begins, members)


def _seconds(time_ns: Ints) -> Floats:
    return np.asarray((time_ns - time_ns[:1]) * 1e-9)


def _list_usable(frames: PointFrames) -> tuple[Floats, Ints, Ints]:
    """Return the usable points (N, 3), the frames' offsets (F + 1,) among them, and their indices (N,) in `frames`."""
    kept = np.flatnonzero(frames.usable)
    counts = np.bincount(frame_of_points(frames.offsets)[kept], minlength=len(frames))
    return frames.points_m[kept].astype(np.float64), np.concatenate([[0], np.cumsum(counts)]), kept


def leave_out_twins(frames: PointFrames) -> PointFrames:
    """Return the frames without points that have no place, or that a frame lists twice."""
    from bench.analysis.kernels.point_links import find_twins

    usable = frames.usable & np.isfinite(frames.points_m).all(axis=1)
    return replace(frames, usable=usable & ~find_twins(frames.points_m, frames.offsets))


def _usual_turn(frames: PointFrames, order: Ints, stride: int) -> tuple[float, float]:
    """Return how far points usually turn from a straight line (m) over so many frames, and the acceleration (m/s²)."""
    from bench.analysis.kernels.point_links import measure_turns

    middle = spread_frames(stride, len(order) - stride, MEASURED_FRAMES)
    triples = frames.take(order[middle[:, None] + np.array([-stride, 0, stride])].ravel())
    points, offsets, _ = _list_usable(triples)
    at = 3 * np.arange(len(middle)) + 1
    turns = measure_turns(points, offsets, _seconds(triples.time_ns), at, 1, FASTEST_M_S)
    turns = turns[np.isfinite(turns[:, 0])]
    if not len(turns):
        return SMALLEST_M, USUAL_M_S2
    return float(np.median(turns[:, 0])), float(np.median(turns[:, 0] / turns[:, 1]))
