"""What the analysis takes from a run file: the tracker's frames and the robot's samples, in host time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.analysis import (
    AlignedClock,
    CounterColumns,
    CycleSource,
    Gaps,
    RobotSigns,
    Travel,
    align_by_arrival,
    align_by_echo,
    count_cycles,
    find_gaps,
    measure_travel,
)
from bench.model import ClockSource, CycleEventKind, Severity, StampKind
from bench.recording import BODIES, CLOCK, CYCLE, FRAME, LOG, POINTS, ROBOT, STATS, Run
from bench.report.results import ClockFinding, NotedLine

__all__ = [
    "BodyPoses",
    "CycleAccount",
    "RobotSamples",
    "TrackerFrames",
    "load_topics",
    "read_account",
    "read_frames",
    "read_noted",
    "read_robot",
]

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

NS = 1_000_000_000
RESUMED = "bench.resumed_from"
"""Metadata of a run that goes on with another."""


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
    """Capture time by the offline clock map, and by the calibrated offset if there is one."""
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

    source: CycleSource | None
    """None where the program counts its cycles itself."""
    counter: CounterColumns
    speed_rad_s: Floats
    """(n,): of the fastest joint, for each of the samples in `counter`; NaN where unknown."""
    travel: Travel | None
    """How far it has moved; None where it does not say where it is."""
    tcp_pose: Floats
    """(n, 6): x, y, z (m) and rotation vector (rad) in the base frame, for each of them; NaN where unknown."""
    tcp_offset: Floats
    """(6,): the TCP in the flange frame as most samples have it, likewise; NaN where unknown."""
    digital_outputs: Ints
    """(n,): bits, for each of the samples; -1 where unknown."""
    gaps: Gaps
    clocks: list[ClockFinding]


@dataclass(frozen=True, eq=False)
class CycleAccount:
    """What the run itself noted about its cycles."""

    first_cycle_index: int = 0
    """Cycles of the runs that this one goes on with."""
    interrupted: dict[int, str] = field(default_factory=dict)
    """What stopped the robot on its path, by `cycle_index`."""
    slowed: dict[int, str] = field(default_factory=dict)
    """How cycles were driven that were slower on purpose, by `cycle_index`."""
    n_unrecorded: int = 0
    """Cycles completed in the run before of which the end was not recorded."""
    resumed_from: str = ""
    """File of the run before; empty if there is none."""


def load_topics(run: Run) -> None:
    """Read all that the analysis needs in one pass over the file."""
    run.load([ROBOT, FRAME, POINTS, BODIES, CLOCK, CYCLE, LOG, STATS])


def read_account(run: Run) -> CycleAccount:
    """Read what the run itself noted about its cycles."""
    events = run[CYCLE]
    details = {
        kind: {int(events.cycle_index[row]): str(events.detail[row]) for row in np.flatnonzero(events.kind == kind)}
        for kind in (CycleEventKind.INTERRUPTED, CycleEventKind.GRANTED)
    }
    return CycleAccount(
        first_cycle_index=_read_count(run, "completed"),
        interrupted=details[CycleEventKind.INTERRUPTED],
        slowed={index: detail for index, detail in details[CycleEventKind.GRANTED].items() if detail},
        n_unrecorded=max(_read_count(run, "completed") - _read_count(run, "recorded"), 0),
        resumed_from=run.metadata.get(RESUMED, {}).get("file", ""),
    )


def _read_count(run: Run, key: str) -> int:
    text = run.metadata.get(RESUMED, {}).get(key, "0")
    return int(text) if text.isdecimal() else 0


def read_noted(run: Run) -> list[NotedLine]:
    """Read the run's log: link events, holds and their ends, warnings."""
    log = run[LOG]
    severities = [max((s for s in Severity if s <= level), default=Severity.INFO) for level in log.severity.tolist()]
    columns = zip(_ints(log.log_time_ns).tolist(), severities, log.name, log.text, strict=True)
    return [NotedLine(host_ns, severity, str(name), str(text)) for host_ns, severity, name, text in columns]


def read_frames(run: Run, offset_s: float = 0.0) -> TrackerFrames:
    """Read the tracker's frames and put them into host time.

    Parameters
    ----------
    run : Run
        The recording.
    offset_s : float
        A constant of the tracker's times that a calibration found: is added to them.
    """
    frame, points = run[FRAME], run[POINTS]
    number, segment = _ints(frame.frame_number), _ints(frame.segment)
    clock = _align_tracker(run, segment)
    time_ns = clock.host_ns + round(offset_s * NS)
    order = np.lexsort((number, segment))
    return TrackerFrames(
        frame_number=number,
        time_ns=time_ns,
        points_m=points.points_m,
        offsets=_ints(points.offsets),
        ids=points.ids,
        flags=points.flags,
        bodies=_read_bodies(run),
        gaps=find_gaps(number[order], segment[order], time_ns[order]),
        clocks=_findings("tracker", clock, run),
    )


def read_robot(run: Run, source: CycleSource | None) -> RobotSamples | None:
    """Read the robot's samples and put them into host time; None without any.

    Parameters
    ----------
    run : Run
        The recording.
    source : CycleSource or None
        How the robot shows its cycles; None where the program counts them.
    """
    state = run[ROBOT]
    if len(state.segment) == 0:
        return None
    ticks, segment = np.rint(state.controller_time_s * NS).astype(np.int64), _ints(state.segment)
    clock = align_by_arrival(ticks, _ints(state.arrival_ns), _ints(state.capture_ns), segment, 1.0)
    order = np.lexsort((ticks, segment))
    host = clock.host_ns[order]
    runtime_state = _ints(state.runtime_state)[order]
    if source is None:
        count, running = _ints(state.cycle_count)[order], _ints(state.cycle_running)[order]
    else:
        signs = RobotSigns(_ints(state.digital_outputs)[order], state.q_rad[order], state.qd_rad_s[order])
        count, running = count_cycles(source, runtime_state, signs)
    phase = np.asarray(state.cycle_phase, dtype=np.float64)[order]
    counter = CounterColumns(host, count, running, phase, runtime_state)
    # the field and not the message's own number, which is 32 bits wide
    gaps = find_gaps(_ints(state["sequence"])[order], segment[order], host)
    speed_rad_s = np.abs(state.qd_rad_s).max(axis=1)[order]
    tcp_pose = np.asarray(state.tcp_pose, dtype=np.float64)[order]
    travel = measure_travel(host, state.q_rad[order], tcp_pose)
    outputs = _ints(state.digital_outputs)[order]
    # recordings of the first version do not have it
    tcp_offset = _usual_row(state.tcp_offset) if "tcp_offset" in state else np.full(6, np.nan)
    return RobotSamples(
        source, counter, speed_rad_s, travel, tcp_pose, tcp_offset, outputs, gaps, _findings("robot", clock, run)
    )


def _align_tracker(run: Run, segment: Ints) -> AlignedClock:
    """Map by the clock's answers, or by the arrivals where the tracker has a clock that nobody can ask."""
    frame, samples = run[FRAME], run[CLOCK]
    ticks, capture_ns = _ints(frame.device_ticks), _ints(frame.capture_ns)
    asked = np.flatnonzero(samples.source == ClockSource.TRACKER)
    frequency = samples.ticks_per_s[asked]
    if len(ticks) and (frame.stamp == StampKind.TRACKER_TIME).all():
        clock_hz = next(float(one.detail["clock_hz"]) for one in run.devices if one.device == "tracker")
        return align_by_arrival(ticks, _ints(frame.arrival_ns), capture_ns, segment, NS / clock_hz)
    return align_by_echo(
        ticks,
        capture_ns,
        segment,
        _ints(samples.segment)[asked],
        _ints(samples.send_ns)[asked],
        _ints(samples.device_ticks)[asked],
        _ints(samples.receive_ns)[asked],
        NS / float(frequency[0]) if len(frequency) else 1.0,
    )


def _read_bodies(run: Run) -> BodyPoses:
    poses = run[BODIES]
    position = np.array(poses.position_m, dtype=np.float64)
    position[~poses.tracking_valid] = np.nan
    return BodyPoses(_ints(poses.frame_index), _ints(poses.body_id), position, poses.quaternion_xyzw)


def _findings(device: str, clock: AlignedClock, run: Run) -> list[ClockFinding]:
    stamped_by = next((info.detail.get("stamped_by", "") for info in run.devices if info.device == device), "")
    return [
        ClockFinding(
            device,
            s.segment,
            s.method,
            s.offset_s,
            s.drift_ppm,
            s.residual_sd_us,
            s.n_samples,
            s.residual_p50_us,
            s.residual_p99_us,
            stamped_by,
        )
        for s in clock.segments
    ]


def _usual_row(rows: Array) -> Floats:
    """Return the median of the rows that are known; NaN without any."""
    values = np.asarray(rows, dtype=np.float64)
    known = values[np.isfinite(values).all(axis=1)]
    return np.asarray(np.median(known, axis=0)) if len(known) else np.full(values.shape[1], np.nan)


def _ints(values: Array) -> Ints:
    return np.asarray(values, dtype=np.int64)
