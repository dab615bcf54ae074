"""What every file format is turned into: a description of the take, and its frames one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from bench.errors import RecordingError
from bench.model import UNLABELED, StampKind, TrackerFrame

__all__ = [
    "LABELED_FLAGS",
    "MAX_POSITION_M",
    "TICKS_PER_S",
    "UNLABELED_FLAGS",
    "Points",
    "Take",
    "TakeInfo",
    "Words",
    "unreadable",
]

TICKS_PER_S = 1_000_000_000
"""Device time of a take is counted in nanoseconds from the take's frame 0."""
LABELED_FLAGS = 0x0A
"""NatNet marker parameters of a measured marker of a rigid body: point-cloud solved (0x02), has a model (0x08)."""
UNLABELED_FLAGS = 0x02 | UNLABELED
"""NatNet marker parameters of a measured marker that belongs to no rigid body."""
MAX_POSITION_M = 1e5
"""A coordinate beyond 100 km is damage in the file, not a marker."""

Points = npt.NDArray[np.float32]
Words = npt.NDArray[np.uint32]


@dataclass(frozen=True)
class TakeInfo:
    """What a take says of itself, and what was found when the number and time of every frame were looked at."""

    format: str
    """`Motive CSV`, `Tracking Tools CSV`, `C3D`, `TRC` or `Parquet`."""
    version: str
    rate_hz: float
    """Frames a second: the header's, or 1 / median time step where the header gives none."""
    stamp: StampKind
    """Which moment the frames' device time denotes."""
    units: str
    """The file's length unit; the frames are in metres whatever it is."""
    frames_promised: int | None
    """Frames according to the header; None where it does not say."""
    frames_found: int
    bodies: dict[int, str] = field(default_factory=dict)
    """Names of the rigid bodies by the ids used in the frames."""
    body_markers: dict[str, list[list[float]]] = field(default_factory=dict)
    """By a rigid body's name: its markers, each (x, y, z) in metres in the body's own frame."""
    marker_names: dict[int, str] = field(default_factory=dict)
    """By the ids used in the frames: the names the file gives to the points, where it gives any."""
    capture_start: str = ""
    """The file's own words for the moment the take began; localised, so not to be relied upon."""
    start_ns: int = 0
    """Unix nanoseconds given to device time 0: 0 where the file does not say when it began."""
    time_origin: str = "unknown: the take's frame 0 is put at 1970-01-01 00:00 UTC"
    """What `start_ns` is, in words."""
    detail: dict[str, str] = field(default_factory=dict)
    """Whatever else the header says."""
    warnings: tuple[str, ...] = ()
    """Sentences that the reader of the results must know."""


@dataclass(frozen=True)
class Take:
    """A take that can be read: what it is, and its frames.

    Attributes
    ----------
    info : TakeInfo
    frames : iterator of TrackerFrame
        In order of capture, positions in metres in the tracker's lab frame. A few hundred frames are held at a
        time; the iterator can be used once. It raises `RecordingError` at a cell that is no number, and after the
        last frame when none of them had a point.
    """

    info: TakeInfo
    frames: Iterator[TrackerFrame]


def unreadable(name: str, what: str, hint: str = "") -> RecordingError:
    """Return the error that the take called `name` cannot be read, because of `what`."""
    return RecordingError(f"The take {name} cannot be read: {what}.", hint=hint)
