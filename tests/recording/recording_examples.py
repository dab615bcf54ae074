"""Records and run files for the tests of the recording."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from bench.model import (
    NO_ID,
    ClockSample,
    ClockSource,
    CycleEvent,
    CycleEventKind,
    LogEntry,
    Record,
    RecorderStats,
    RigidBody,
    RobotState,
    RunState,
    Severity,
    StampKind,
    StateChange,
    TrackerFrame,
)
from bench.recording import RunWriter
from bench.timing import Clock, ManualClock

T0_NS = 1_700_000_000_000_000_000
MINIMAL_TOML = """
[cable]
length_m = 1.2
diameter_mm = 8.0
marker_arc_length_m = [0.1, 0.2, 0.3]
minimum_bend_radius_mm = 60.0
[cable.anchor]
kind = "static_marker"
"""


def make_frame(i: int, n_points: int = 12, n_bodies: int = 0, **changes: Any) -> TrackerFrame:
    rng = np.random.default_rng(i)
    bodies = tuple(
        RigidBody(b + 1, tuple(rng.random(3)), tuple(rng.random(4)), float(rng.random()), bool(b % 2))
        for b in range(n_bodies)
    )
    values: dict[str, Any] = {
        "arrival_ns": T0_NS + 10_000_000 * i,
        "capture_ns": T0_NS + 10_000_000 * i - 3_000_000,
        "frame_number": 1000 + i,
        "device_ticks": 100_000 * i,
        "stamp": StampKind.MID_EXPOSURE,
        "points_m": rng.random((n_points, 3), dtype=np.float32),
        "ids": np.full(n_points, NO_ID, np.uint32),
        "flags": np.full(n_points, 0x12, np.uint32),
        "residual_m": rng.random(n_points, dtype=np.float32),
        "bodies": bodies,
    }
    return TrackerFrame(**(values | changes))


def make_state(i: int, **changes: Any) -> RobotState:
    values: dict[str, Any] = {
        "arrival_ns": T0_NS + 2_000_000 * i,
        "capture_ns": T0_NS + 2_000_000 * i - 100_000,
        "sequence": i,
        "segment": 0,
        "controller_time_s": 0.002 * i,
        "q_rad": tuple(0.1 * i + j for j in range(6)),
        "cycle_count": i // 100,
    }
    return RobotState(**(values | changes))


def one_of_each() -> list[Record]:
    return [
        StateChange(T0_NS, RunState.RUNNING, "grün und bereit"),
        make_state(1),
        make_frame(1, n_points=3, n_bodies=2),
        ClockSample(ClockSource.TRACKER, T0_NS, 77, T0_NS + 300_000, 1e7, 2),
        CycleEvent(T0_NS + 5, CycleEventKind.STARTED, 41, 12.5, "register 24"),
        LogEntry(T0_NS + 6, Severity.WARN, "robot", "link lost"),
        RecorderStats(T0_NS + 7, "/robot/state", 6, 5, 4, 1, 2, 17, 3.25),
    ]


def open_writer(path: Path, clock: Clock | None = None, **changes: Any) -> RunWriter:
    values: dict[str, Any] = {"config_toml": MINIMAL_TOML, "versions": {"bench": "0.1.0"}, "run_id": "run-7"}
    return RunWriter(path, clock or ManualClock(T0_NS), **(values | changes))


def write_run(path: Path, records: Iterable[Record], *, exit_status: str = "success") -> Path:
    writer = open_writer(path)
    writer.put_all(records)
    return writer.close(exit_status=exit_status, reason="all cycles done")


int64 = st.integers(-(2**63), 2**63 - 1)
int32 = st.integers(-(2**31), 2**31 - 1)
uint32 = st.integers(0, 2**32 - 1)
uint64 = st.integers(0, 2**64 - 1)
float64 = st.floats(width=64)
float32 = st.floats(width=32)
vector6 = st.tuples(*[float64] * 6)
text = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=30)

robot_states = st.builds(
    RobotState,
    arrival_ns=int64,
    capture_ns=int64,
    sequence=int64,
    segment=int32,
    controller_time_s=float64,
    q_rad=vector6,
    qd_rad_s=vector6,
    target_q_rad=vector6,
    current_a=vector6,
    joint_temperature_c=vector6,
    tcp_pose=vector6,
    tcp_speed=vector6,
    tcp_force=vector6,
    speed_scaling=float64,
    speed_fraction=float64,
    runtime_state=int32,
    robot_mode=int32,
    safety_status=int32,
    digital_inputs=uint64,
    digital_outputs=uint64,
    cycle_count=int32,
    cycle_running=int32,
    cycle_phase=float64,
)
rigid_bodies = st.builds(
    RigidBody,
    body_id=int64,
    position_m=st.tuples(*[float64] * 3),
    quaternion_xyzw=st.tuples(*[float64] * 4),
    mean_error_m=float64,
    tracking_valid=st.booleans(),
)


@st.composite
def tracker_frames(draw: st.DrawFn) -> TrackerFrame:
    n = draw(st.integers(0, 6))
    points = draw(st.lists(st.tuples(float32, float32, float32), min_size=n, max_size=n))
    numbers = st.lists(uint32, min_size=n, max_size=n)
    return TrackerFrame(
        arrival_ns=draw(int64),
        capture_ns=draw(int64),
        frame_number=draw(int64),
        device_ticks=draw(int64),
        stamp=draw(st.sampled_from(StampKind)),
        points_m=np.array(points, np.float32).reshape(n, 3),
        ids=np.array(draw(numbers), np.uint32),
        flags=np.array(draw(numbers), np.uint32),
        residual_m=np.array(draw(st.lists(float32, min_size=n, max_size=n)), np.float32),
        bodies=tuple(draw(st.lists(rigid_bodies, max_size=4))),
        segment=draw(int32),
    )


clock_samples = st.builds(
    ClockSample,
    source=st.sampled_from(ClockSource),
    send_ns=int64,
    device_ticks=int64,
    receive_ns=int64,
    ticks_per_s=float64,
    segment=int32,
)
cycle_events = st.builds(
    CycleEvent,
    host_ns=int64,
    kind=st.sampled_from(CycleEventKind),
    cycle_index=int64,
    controller_time_s=float64,
    detail=text,
)
state_changes = st.builds(StateChange, host_ns=int64, state=st.sampled_from(RunState), reason=text)
log_entries = st.builds(
    LogEntry, host_ns=st.integers(0, 2**63 - 1), severity=st.sampled_from(Severity), name=text, text=text
)
records = st.one_of(robot_states, tracker_frames(), clock_samples, cycle_events, state_changes, log_entries)
