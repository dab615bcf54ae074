"""What every sorter is given and what it returns: a tracker's unlabeled points, and the cable's markers among them."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from bench.analysis.arrays import Bools, Floats, Floats32, Indices, Ints
from bench.errors import AnalysisError

__all__ = ["MarkerReason", "PointFrames", "SortedMarkers", "gather_positions"]

Number = TypeVar("Number", np.float64, np.int64)
MOST_POINTS = np.iinfo(np.int16).max


class MarkerReason(IntEnum):
    """Why a marker has its point in a frame, or none."""

    FOUND = 0
    """The point is the marker's without doubt."""
    HIDDEN = 1
    """No point lies where the marker must be, or the chain ended before it."""
    AMBIGUOUS = 2
    """More than one point, or order of points, fits nearly as well: given the better one, or none."""
    NO_START = 3
    """Nothing tells where the cable starts in this frame: no anchor, or no chain that fits."""
    FILLED = 4
    """The frame by itself does not tell; the frames before and after do."""
    BROKEN = 5
    """Its point broke an invariant (spacing, speed, one point for one marker) and was taken away."""


@dataclass(frozen=True, eq=False)
class PointFrames:
    """F frames as the tracker lists them, and what else is known of the cable in them; any order of time."""

    points_m: Floats32
    """(N, 3): all points of all frames, lab frame."""
    offsets: Ints
    """(F + 1,): points of frame f are ``points_m[offsets[f]:offsets[f + 1]]``."""
    usable: Bools
    """(N,): points that may be the cable's: not those of rigid bodies or static markers."""
    anchor_m: Floats | None
    """(F, 3): start of the cable, NaN where unknown; None for a cable without anchor."""
    time_ns: Ints
    """(F,): capture times."""
    end_m: Floats | None = None
    """(F, 3): the cable's other end, NaN where unknown; None where nothing tells it."""
    end_sigma_m: Floats | None = None
    """(F,): standard deviation of `end_m` in the worst direction."""
    cycle: Ints | None = None
    """(F,): each frame's cycle, -1 outside any; None where the motion has no cycles."""
    phase: Floats | None = None
    """(F,): place on the robot's path, 0…1, NaN outside any cycle."""

    def __post_init__(self) -> None:
        most = int(np.diff(self.offsets).max(initial=0))
        if most > MOST_POINTS:
            raise AnalysisError(f"A frame has {most} points; at most {MOST_POINTS} can be sorted.")

    def __len__(self) -> int:
        """Return the number F of frames."""
        return len(self.offsets) - 1

    def take(self, frames: Ints) -> PointFrames:
        """Return some of the frames (C,), in that order."""
        counts = np.diff(self.offsets)[frames]
        offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        chosen = np.repeat(self.offsets[frames] - offsets[:-1], counts) + np.arange(offsets[-1])
        return PointFrames(
            self.points_m[chosen],
            offsets,
            self.usable[chosen],
            _rows(self.anchor_m, frames),
            self.time_ns[frames],
            _rows(self.end_m, frames),
            _rows(self.end_sigma_m, frames),
            _rows(self.cycle, frames),
            _rows(self.phase, frames),
        )


def _rows(column: npt.NDArray[Number] | None, frames: Ints) -> npt.NDArray[Number] | None:
    return None if column is None else column[frames]


@dataclass(frozen=True, eq=False)
class SortedMarkers:
    """The cable's k markers in each of F frames, counted from the anchor."""

    source: Indices
    """(F, k): index of the marker's point in the frame's list, -1 where it was not found."""
    position_m: Floats32
    """(F, k, 3): lab frame, NaN where not found."""
    confidence: Floats32
    """(F,): mean of the markers' confidence; 0…1."""
    marker_confidence: Floats32
    """(F, k): how sure each marker's point is, 0 where it has none; 0…1."""
    reason: npt.NDArray[np.uint8]
    """(F, k): `MarkerReason`."""
    method: str = ""
    """Name of the method that was used."""
    notes: list[str] = field(default_factory=list)
    """Sentences on how it was done: why this method, what was learnt."""
    warnings: list[str] = field(default_factory=list)
    """Sentences on what is doubtful."""

    @classmethod
    def from_source(
        cls,
        frames: PointFrames,
        source: Indices,
        marker_confidence: Floats32,
        reason: npt.NDArray[np.uint8],
        method: str,
        notes: list[str] | None = None,
        warnings: list[str] | None = None,
    ) -> SortedMarkers:
        """Return the markers whose points `source` (F, k) names."""
        return cls(
            source,
            gather_positions(frames.points_m, frames.offsets, source),
            marker_confidence.mean(axis=1, dtype=np.float32),
            marker_confidence,
            reason,
            method,
            notes or [],
            warnings or [],
        )


def gather_positions(points_m: Floats32, offsets: Ints, source: Indices) -> Floats32:
    """Return the positions (F, k, 3) of the points that `source` (F, k) names, NaN where it is -1."""
    position = np.full((*source.shape, 3), np.nan, dtype=np.float32)
    found = source >= 0
    position[found] = points_m[(offsets[:-1, None] + source)[found]]
    return position
