"""Some frames of a take at a time, as arrays; and one after the other, as a tracker would have sent them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.drivers.takes.take import Points, TakeInfo, Words, unreadable
from bench.model import RigidBody, TrackerFrame

__all__ = ["Ascending", "Floats", "Ints", "Mask", "Rows", "Stamps", "Ticks", "make_frames"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Stamps:
    """Which n frames they are, and when they were captured according to the file."""

    line: Ints
    """(n,): numbers of their lines in the file, from 1; 0 where the file has no lines."""
    number: Ints
    """(n,)"""
    time_s: Floats
    """(n,): NaN where the file gives no times."""

    def __len__(self) -> int:
        return len(self.number)

    def keep(self, mask: Mask) -> Stamps:
        return Stamps(self.line[mask], self.number[mask], self.time_s[mask])


Ticks = Callable[[Stamps], Sequence[int]]
"""Gives each frame its capture time, nanoseconds after the take began."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """n frames as they stand in the file, with all their N points."""

    stamps: Stamps
    n_points: Ints
    """(n,): points of each frame."""
    points_m: Points
    """(N, 3)"""
    ids: Words
    """(N,)"""
    flags: Words
    """(N,)"""
    residual_m: Points
    """(N,): NaN where the file gives none."""
    bodies: Sequence[tuple[RigidBody, ...]] = ()
    """n of them, or none at all where no frame has a rigid body."""

    def keep(self, mask: Mask) -> Rows:
        """Return the frames for which `mask` is true."""
        if mask.all():
            return self
        points = np.repeat(mask, self.n_points)
        return Rows(
            self.stamps.keep(mask),
            self.n_points[mask],
            self.points_m[points],
            self.ids[points],
            self.flags[points],
            self.residual_m[points],
            [bodies for bodies, kept in zip(self.bodies, mask, strict=True) if kept] if self.bodies else (),
        )


class Ascending:
    """Tells, block after block, which frames ascend in number and do not go back in time."""

    def __init__(self) -> None:
        self.n_left_out = 0
        self.first_line = 0
        """Line of the first frame that does not ascend."""
        self._number = -1
        self._time_s = -np.inf

    def mask(self, stamps: Stamps) -> Mask:
        """Return for each frame whether it comes after all those before it."""
        number = np.concatenate([[self._number], stamps.number])
        time_s = np.concatenate([[self._time_s], stamps.time_s])
        if (number[1:] > number[:-1]).all() and not (time_s[1:] < time_s[:-1]).any():
            kept = np.ones(len(stamps), bool)
        else:
            kept = self._compare_one_by_one(stamps)
        if kept.any():
            last = int(np.flatnonzero(kept)[-1])
            self._number, self._time_s = int(stamps.number[last]), float(stamps.time_s[last])
        return kept

    def _compare_one_by_one(self, stamps: Stamps) -> Mask:
        kept = np.zeros(len(stamps), bool)
        last_number, last_s = self._number, self._time_s
        for i, (number, time_s) in enumerate(zip(stamps.number.tolist(), stamps.time_s.tolist(), strict=True)):
            if number > last_number and not time_s < last_s:
                last_number, last_s, kept[i] = number, time_s, True
        lines = stamps.line[~kept]
        self.first_line = self.first_line or int(lines[0])
        self.n_left_out += len(lines)
        return kept


def make_frames(name: str, blocks: Iterable[Rows], ticks: Ticks, info: TakeInfo) -> Iterator[TrackerFrame]:
    """Yield the frames of `blocks` that ascend, as the tracker would have sent them.

    Raises
    ------
    RecordingError
        After the last frame, when none of them had a point.
    """
    ascending, n_points = Ascending(), 0
    for block in blocks:
        rows = block.keep(ascending.mask(block.stamps))
        n_points += len(rows.points_m)
        yield from _frames_of(rows, ticks(rows.stamps), info)
    if n_points == 0:
        raise unreadable(name, f"no marker is seen in any of its {info.frames_found} frames")


def _frames_of(rows: Rows, ticks: Sequence[int], info: TakeInfo) -> Iterator[TrackerFrame]:
    start_ns, stamp = info.start_ns, info.stamp
    points_m, ids, flags, residual_m = rows.points_m, rows.ids, rows.flags, rows.residual_m
    bodies = rows.bodies or ((),) * len(rows.stamps)
    ends = np.cumsum(rows.n_points).tolist()
    start = 0
    for number, tick, end, own in zip(rows.stamps.number.tolist(), ticks, ends, bodies, strict=True):
        yield TrackerFrame(
            arrival_ns=start_ns + tick,
            capture_ns=start_ns + tick,
            frame_number=number,
            device_ticks=tick,
            stamp=stamp,
            points_m=points_m[start:end],
            ids=ids[start:end],
            flags=flags[start:end],
            residual_m=residual_m[start:end],
            bodies=own,
        )
        start = end
