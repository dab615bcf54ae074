"""What the analysis takes from a run file: the tracker's frames and the robot's samples, in host time."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from bench.analysis import AlignedClock, CounterColumns, Gaps, align_by_arrival, align_by_echo, find_gaps
from bench.config import Config
from bench.errors import AnalysisError
from bench.model import ClockSource, DeviceInfo
from bench.report.results import ClockFinding

__all__ = ["BodyPoses", "RecordedRun", "RobotSamples", "TrackerFrames", "read_frames", "read_robot"]

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

NS = 1_000_000_000
POINT_COLUMNS = ("points_m", "ids", "flags", "offsets")


class RecordedRun(Protocol):
    """A run file as `bench.recording.open_run` gives it."""

    @property
    def status(self) -> object: ...
    @property
    def config(self) -> Config: ...
    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]: ...
    @property
    def topics(self) -> Collection[str]: ...
    @property
    def devices(self) -> Sequence[DeviceInfo]: ...
    def __getitem__(self, topic: str) -> Mapping[str, Array]: ...


@dataclass(frozen=True, eq=False)
class BodyPoses:
    """Rigid bodies of all frames, one row for each pose."""

    frame: Ints
    """(b,): index of the frame."""
    body_id: Ints
    position_m: Floats
    """(b, 3): NaN where the tracker says that the body is not tracked."""
    quaternion_xyzw: Floats
    """(b, 4)"""


@dataclass(frozen=True, eq=False)
class TrackerFrames:
    """The tracker's F frames, in the order of the recording."""

    frame_number: Ints
    time_ns: Ints
    """Capture time by the offline clock map."""
    points_m: npt.NDArray[np.float32]
    offsets: Ints
    ids: Array
    flags: Array
    bodies: BodyPoses
    gaps: Gaps
    clocks: list[ClockFinding]

    def __len__(self) -> int:
        return len(self.frame_number)


@dataclass(frozen=True, eq=False)
class RobotSamples:
    """The robot's own account of its cycles."""

    counter: CounterColumns
    gaps: Gaps
    clocks: list[ClockFinding]


def read_frames(run: RecordedRun) -> TrackerFrames:
    """Read the tracker's frames and put them into host time.

    Raises
    ------
    AnalysisError
        The points and the frames of the recording do not belong together.
    """
    frame, points = _columns(run, "/tracker/frame"), _columns(run, "/tracker/points")
    number = _ints(frame, "frame_number")
    point_columns = _point_columns(points)
    if len(point_columns["offsets"]) != len(number) + 1:
        n_clouds = len(point_columns["offsets"]) - 1
        raise AnalysisError(
            f"The recording holds {len(number)} frames but the points of {n_clouds}.",
            hint="Rebuild it with: bench salvage RUN.mcap --output GOOD.mcap",
        )
    segment = _ints(frame, "segment")
    clock = _align_tracker(run, frame, segment)
    order = np.lexsort((number, segment))
    return TrackerFrames(
        frame_number=number,
        time_ns=clock.host_ns,
        bodies=_read_bodies(run, number, _ints(frame, "n_bodies")),
        gaps=find_gaps(number[order], segment[order], clock.host_ns[order]),
        clocks=_findings("tracker", clock),
        **point_columns,
    )


def read_robot(run: RecordedRun) -> RobotSamples | None:
    """Read the robot's samples and put them into host time; None without any."""
    state = _columns(run, "/robot/state")
    if not len(state.get("segment", ())):
        return None
    ticks = np.rint(state["controller_time_s"] * NS).astype(np.int64)
    segment = _ints(state, "segment")
    clock = align_by_arrival(ticks, _ints(state, "arrival_ns"), _ints(state, "capture_ns"), segment, 1.0)
    order = np.lexsort((ticks, segment))
    host = clock.host_ns[order]
    counter = CounterColumns(
        host_ns=host,
        count=_ints(state, "cycle_count")[order],
        running=_ints(state, "cycle_running")[order],
        phase=np.asarray(state["cycle_phase"], dtype=np.float64)[order],
        runtime_state=_ints(state, "runtime_state")[order],
    )
    gaps = find_gaps(_ints(state, "sequence")[order], segment[order], host)
    return RobotSamples(counter, gaps, _findings("robot", clock))


def _align_tracker(run: RecordedRun, frame: Mapping[str, Array], segment: Ints) -> AlignedClock:
    samples = _columns(run, "/clock/sample")
    asked = np.flatnonzero(_ints(samples, "source") == ClockSource.TRACKER)
    frequency = np.asarray(samples.get("ticks_per_s", np.zeros(0)))[asked]
    return align_by_echo(
        _ints(frame, "device_ticks"),
        _ints(frame, "capture_ns"),
        segment,
        _ints(samples, "segment")[asked],
        _ints(samples, "send_ns")[asked],
        _ints(samples, "device_ticks")[asked],
        _ints(samples, "receive_ns")[asked],
        NS / float(frequency[0]) if len(frequency) else 1.0,
    )


def _read_bodies(run: RecordedRun, number: Ints, n_bodies: Ints) -> BodyPoses:
    poses = _columns(run, "/tracker/bodies")
    pose_number = _ints(poses, "frame_number")
    if int(n_bodies.sum()) == len(pose_number):
        frame = np.repeat(np.arange(len(number)), n_bodies)
    else:  # a damaged recording: only the frame numbers still tell
        order = np.argsort(number, kind="stable")
        at = np.minimum(np.searchsorted(number[order], pose_number), max(len(number) - 1, 0))
        frame = order[at] if len(number) else np.zeros(0, dtype=np.int64)
    position = np.array(poses.get("position_m", np.zeros((0, 3))), dtype=np.float64)
    position[~np.asarray(poses.get("tracking_valid", np.zeros(0)), dtype=bool)] = np.nan
    quaternion = np.asarray(poses.get("quaternion_xyzw", np.zeros((0, 4))), dtype=np.float64)
    kept = number[frame] == pose_number if len(number) else np.zeros(len(pose_number), dtype=bool)
    return BodyPoses(frame[kept], _ints(poses, "body_id")[kept], position[kept], quaternion[kept])


def _point_columns(points: Mapping[str, Array]) -> dict[str, Array]:
    if not points:
        return {
            "points_m": np.zeros((0, 3), dtype=np.float32),
            "offsets": np.zeros(1, dtype=np.int64),
            "ids": np.zeros(0, dtype=np.uint32),
            "flags": np.zeros(0, dtype=np.uint32),
        }
    return {name: points[name] for name in POINT_COLUMNS}


def _findings(device: str, clock: AlignedClock) -> list[ClockFinding]:
    return [
        ClockFinding(device, s.segment, s.method, s.offset_s, s.drift_ppm, s.residual_sd_us, s.n_samples)
        for s in clock.segments
    ]


def _columns(run: RecordedRun, topic: str) -> Mapping[str, Array]:
    return run[topic] if topic in run.topics else {}


def _ints(columns: Mapping[str, Array], name: str) -> Ints:
    return np.asarray(columns.get(name, np.zeros(0)), dtype=np.int64)
