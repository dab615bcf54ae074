"""Run files whose truth is known, written by the real recorder: a circular cable that a robot bends and unbends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.model import (
    NO_ID,
    ClockSample,
    ClockSource,
    DeviceInfo,
    RigidBody,
    RobotState,
    StampKind,
    TrackerFrame,
)
from bench.recording import RunWriter
from bench.timing import ManualClock

T0_NS = 1_700_000_000_000_000_000
ARC_LENGTH_M = (0.06, 0.18, 0.30, 0.42, 0.54, 0.66)
CYCLE_S = 0.8
WAIT_S = 0.2
START_S = 0.3
ROBOT_HZ = 125
TRACKER_HZ = 100
TRACKER_LATE_NS = 2_500_000
TOML = """
[run]
name = "example"
sample_id = "circle"
[cable]
length_m = 0.8
diameter_mm = 8.0
marker_arc_length_m = [0.06, 0.18, 0.30, 0.42, 0.54, 0.66]
minimum_bend_radius_mm = {limit_mm}
[cable.anchor]
{anchor}
[analysis]
{analysis}
"""
ROBOT_TOML = """
[robot]
host = "192.0.2.10"
program = "bend_test.urp"
rate_hz = 125
"""
STATIC_ANCHOR = 'kind = "static_marker"'
BODY_ANCHOR = 'kind = "rigid_body"\nname = "pole"'
BODY_M = np.array([[-0.03, 0.0, 0.03], [0.03, 0.0, 0.03], [0.0, 0.0, -0.06]])
UNLABELED_FLAGS, LABELED_FLAGS = 0x12, 0x0A


@dataclass
class RunSpec:
    """What to write; the hooks change or leave out (None) what would be written."""

    n_cycles: int = 3
    anchor: str = STATIC_ANCHOR
    analysis: str = ""
    extra_toml: str = ""
    limit_mm: float = 100.0
    robot: bool = True
    exit_status: str = "success"
    finish: bool = True
    echoes: bool = True
    devices: Sequence[DeviceInfo] = ()
    ghosts_m: Sequence[tuple[float, float, float]] = ()
    seconds: float | None = None
    change_state: Callable[[RobotState], RobotState | None] = field(default=lambda state: state)
    change_points: Callable[[int, dict[str, Any]], dict[str, Any] | None] = field(default=lambda _, values: values)
    extra: dict[str, dict[str, str]] = field(default_factory=dict)


def radius_at(phase: np.ndarray | float) -> Any:
    """Return the cable's bend radius: 400 mm at rest, 150 mm half way."""
    return 0.4 - 0.25 * np.sin(np.pi * np.asarray(phase)) ** 2


def cycle_at(seconds: float) -> tuple[int, bool, float]:
    """Return completed cycles, whether on the path, and the phase, at a time after the start."""
    since = seconds - START_S + 1e-9
    if since < 0:
        return 0, False, 0.0
    cycle, inside = divmod(since, CYCLE_S + WAIT_S)
    return (int(cycle), True, inside / CYCLE_S) if inside < CYCLE_S else (int(cycle) + 1, False, 1.0)


def write_run(path: Path, spec: RunSpec) -> np.ndarray:
    """Write the run and return the truth: `source` (F, k) of every frame that was written."""
    seconds = spec.seconds or START_S + spec.n_cycles * (CYCLE_S + WAIT_S) + 0.1
    toml = TOML.format(limit_mm=spec.limit_mm, anchor=spec.anchor, analysis=spec.analysis)
    toml += (ROBOT_TOML if spec.robot else "") + spec.extra_toml
    clock = ManualClock(T0_NS)
    writer = RunWriter(path, clock, config_toml=toml, versions={"bench": "0"}, run_id="example", extra=spec.extra)
    for device in spec.devices:
        writer.add_device(device)
    truth = _put_everything(writer, spec, seconds)
    if spec.finish:
        writer.close(exit_status=spec.exit_status, reason="as told")
    else:  # what a killed process leaves: drained and synced, never finished
        while writer.queue_length:
            clock.advance_ns(2_000_000_000)
        clock.advance_ns(2_000_000_000)
        _copy_when_synced(writer, path)
    return np.array(truth, dtype=np.int16).reshape(-1, len(ARC_LENGTH_M))


def _copy_when_synced(writer: RunWriter, path: Path) -> None:
    closed = writer.close(exit_status="success", reason="")
    content = closed.read_bytes()
    closed.unlink()
    path.with_name(path.name + ".active").write_bytes(content[: int(len(content) * 0.6)])


def _put_everything(writer: RunWriter, spec: RunSpec, seconds: float) -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    if spec.robot:
        for i in range(int(seconds * ROBOT_HZ)):
            state = spec.change_state(_make_state(i, seconds, spec.n_cycles))
            if state is not None:
                writer.put(state)
    if spec.echoes:
        for t in np.arange(0, seconds, 0.25):
            ns = T0_NS + round(t * 1e9)
            writer.put(ClockSample(ClockSource.TRACKER, ns - 100_000, round(t * 1e7), ns + 100_000, 1e7))
    truth = []
    for i in range(int(seconds * TRACKER_HZ)):
        values, source = _make_frame(rng, i, spec)
        changed = spec.change_points(i, values)
        if changed is not None:
            writer.put(TrackerFrame(**changed))
            truth.append(source)
    return truth


def _make_state(i: int, seconds: float, n_cycles: int) -> RobotState:
    count, running, phase = cycle_at(i / ROBOT_HZ)
    if count >= n_cycles:
        count, running, phase = n_cycles, False, 1.0
    ns = T0_NS + round(i / ROBOT_HZ * 1e9)
    return RobotState(
        arrival_ns=ns + 150_000,
        capture_ns=ns,
        sequence=i,
        segment=0,
        controller_time_s=50.0 + i / ROBOT_HZ,
        runtime_state=2,
        cycle_count=count,
        cycle_running=int(running),
        cycle_phase=phase,
    )


def _make_frame(rng: np.random.Generator, i: int, spec: RunSpec) -> tuple[dict[str, Any], np.ndarray]:
    ns = T0_NS + round(i / TRACKER_HZ * 1e9)
    _, running, phase = cycle_at(i / TRACKER_HZ)
    radius = float(radius_at(phase if running else 0.0))
    angle = np.array(ARC_LENGTH_M) / radius
    markers = np.stack([radius * np.sin(angle), radius * (1 - np.cos(angle)), 0 * angle], axis=1)
    body = "rigid_body" in spec.anchor
    anchor = BODY_M if body else np.zeros((1, 3))
    points = np.concatenate([markers, anchor, np.array(spec.ghosts_m).reshape(-1, 3)])
    labeled = np.zeros(len(points), dtype=bool)
    labeled[len(markers) : len(markers) + len(anchor)] = body
    order = rng.permutation(len(points))
    source = np.empty(len(points), dtype=np.int16)
    source[order] = np.arange(len(points))
    ids = np.where(labeled, (1 << 16) + 1 + np.arange(len(points)) - len(markers), NO_ID)
    values = {
        "arrival_ns": ns + TRACKER_LATE_NS,
        "capture_ns": ns + 1_000,
        "frame_number": 1_000 + i,
        "device_ticks": round(i / TRACKER_HZ * 1e7),
        "stamp": StampKind.MID_EXPOSURE,
        "points_m": (points + rng.normal(0, 5e-5, points.shape))[order].astype(np.float32),
        "ids": ids[order].astype(np.uint32),
        "flags": np.where(labeled, LABELED_FLAGS, UNLABELED_FLAGS)[order].astype(np.uint32),
        "residual_m": np.full(len(points), np.nan, dtype=np.float32),
        "bodies": (RigidBody(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 1e-4, True),) if body else (),
    }
    return values, source[: len(markers)]
