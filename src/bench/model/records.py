"""What the devices say and what the run does, one frozen record for each message.

Host times (``*_ns``) are Unix nanoseconds of the run's clock (`bench.timing`). Lengths are metres, angles radians.
A missing value is NaN, or -1 for an integer, or `NO_BITS`; never zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from bench.model.enums import ClockSource, CycleEventKind, RunState, Severity, StampKind

__all__ = [
    "NAN3",
    "NAN6",
    "NO_BITS",
    "NO_ID",
    "UNLABELED",
    "ClockSample",
    "CycleEvent",
    "DeviceInfo",
    "LogEntry",
    "Record",
    "RecorderStats",
    "RigidBody",
    "RobotState",
    "StateChange",
    "TrackerFrame",
    "Vector3",
    "Vector6",
]

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
NAN3: Vector3 = (float("nan"),) * 3
NAN6: Vector6 = (float("nan"),) * 6
NO_BITS = 0xFFFFFFFFFFFFFFFF
"""The digital inputs or outputs of a controller that does not tell them: no controller has 64 of them."""
NO_ID = 0xFFFFFFFF
"""The ``id`` of a marker whose tracker gives none (a Tracking Tools take writes 0 for every marker)."""
UNLABELED = 0x10
"""Bit of a marker's ``flags``: the tracker assigns it to no rigid body (NatNet's own bit, params & 0x10)."""


@dataclass(frozen=True, slots=True)
class RobotState:
    """One sample of the robot controller's state stream."""

    arrival_ns: int
    """Host time at which the last byte of the package was received."""
    capture_ns: int
    """`controller_time_s` mapped to host time by the map known online; the report recomputes it."""
    sequence: int
    """Place on the controller's time grid: round(controller_time_s * rate_hz)."""
    segment: int
    """Number of the clock segment, from 0; a reconnect or a controller restart begins a new one."""
    controller_time_s: float
    """Raw controller time, seconds since the controller started."""
    q_rad: Vector6 = NAN6
    """Actual joint positions."""
    qd_rad_s: Vector6 = NAN6
    """Actual joint velocities."""
    target_q_rad: Vector6 = NAN6
    """Target joint positions."""
    current_a: Vector6 = NAN6
    """Actual joint currents, amperes."""
    joint_temperature_c: Vector6 = NAN6
    """Joint temperatures, degrees Celsius."""
    tcp_pose: Vector6 = NAN6
    """Actual TCP pose in the base frame: x, y, z (m), rotation vector (rad)."""
    tcp_speed: Vector6 = NAN6
    """Actual TCP speed in the base frame: m/s and rad/s."""
    tcp_force: Vector6 = NAN6
    """TCP wrench in the base frame: N and Nm."""
    speed_scaling: float = float("nan")
    """Trajectory limiter, 0…1."""
    speed_fraction: float = float("nan")
    """Speed slider, 0…1."""
    runtime_state: int = -1
    """UR: 0 stopping, 1 stopped, 2 playing, 3 pausing, 4 paused, 5 resuming."""
    robot_mode: int = -1
    """UR robot mode; 7 is running."""
    safety_status: int = -1
    """UR safety status; 1 is normal, 3 a protective stop."""
    digital_inputs: int = NO_BITS
    """Bits of the actual digital inputs; Modbus: bit n is set while the map's n-th interlock, from 0, is in order."""
    digital_outputs: int = NO_BITS
    """Bits of the actual digital outputs."""
    cycle_count: int = -1
    """Cycles completed since the program started: the register `[robot.cycle] register`."""
    cycle_running: int = -1
    """1 while the robot is on its path, 0 while it waits for the next grant."""
    cycle_phase: float = float("nan")
    """Place on the path, 0…1, where the program writes it into a register."""
    target_qd_rad_s: Vector6 = NAN6
    """Target joint velocities."""
    safety_status_bits: int = -1
    """UR: bit 0 normal, 1 reduced, 2 protective stop, 3 recovery, 4 safeguard stop, 5 system emergency stop, 6 robot
    emergency stop, 7 emergency stop, 8 violation, 9 fault, 10 stopped due to safety, 11 3-position enabling stop."""
    robot_status_bits: int = -1
    """UR: bit 0 power on, 1 program running, 2 teach button, 3 power button."""
    tcp_offset: Vector6 = NAN6
    """TCP in the flange frame: x, y, z (m), rotation vector (rad)."""
    payload_kg: float = float("nan")
    """Mass of the payload that is set on the controller."""
    payload_cog_m: Vector3 = NAN3
    """Its centre of gravity in the flange frame."""
    script_control_line: int = -1
    """Line of the robot program that has control."""
    time_scale_source: int = -1
    """UR: number of the limit that slows the trajectory."""
    collision_detection_ratio: float = float("nan")
    """Share of the force limit, 1 where a collision stops the robot."""
    joint_position_deviation_ratio: float = float("nan")
    """Share of the allowed deviation from the target, 1 where it stops the robot."""
    main_voltage_v: float = float("nan")
    """Of the controller's safety board."""
    robot_current_a: float = float("nan")
    """Of the whole arm, amperes."""
    control_step: int = -1
    """Steps of the control loop since the controller started."""


@dataclass(frozen=True, slots=True)
class RigidBody:
    """Pose of one rigid body as the tracker computed it, in the lab frame."""

    body_id: int
    position_m: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]
    mean_error_m: float = float("nan")
    tracking_valid: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class TrackerFrame:
    """All points of one exposure, in the tracker's own order."""

    arrival_ns: int
    """Host time at which the packet was received; for an imported take the capture time again."""
    capture_ns: int
    """Capture time mapped to host time by the map known online; the report recomputes it."""
    frame_number: int
    """The tracker's own frame number."""
    device_ticks: int
    """Raw capture time in ticks of the tracker's clock (`ClockSample.ticks_per_s`)."""
    stamp: StampKind
    """Which moment `device_ticks` denotes."""
    points_m: npt.NDArray[np.float32]
    """Shape (n, 3), lab frame."""
    ids: npt.NDArray[np.uint32]
    """Shape (n,): the tracker's identity of each point, not to be trusted; `NO_ID` where it gives none."""
    flags: npt.NDArray[np.uint32]
    """Shape (n,): NatNet marker parameters; `UNLABELED` where the point belongs to no rigid body."""
    residual_m: npt.NDArray[np.float32]
    """Shape (n,): the tracker's own residual, NaN where it gives none."""
    bodies: tuple[RigidBody, ...] = ()
    """Rigid bodies of this exposure."""
    segment: int = 0
    """Number of the clock segment, from 0; a restart of the tracker begins a new one."""
    ptp_seconds: int = 0
    """PTP time of the exposure, where the cameras have one: whole seconds."""
    ptp_fraction: int = 0
    """Its fraction, as the tracker gives it."""


@dataclass(frozen=True, slots=True)
class ClockSample:
    """One question and answer about a device's clock."""

    source: ClockSource
    send_ns: int
    """Host time just before the request was sent."""
    device_ticks: int
    """The device's clock as it answered."""
    receive_ns: int
    """Host time just after the answer was received."""
    ticks_per_s: float
    """Nominal frequency of the device's clock."""
    segment: int = 0


@dataclass(frozen=True, slots=True)
class CycleEvent:
    """Something that happened to a cycle."""

    host_ns: int
    kind: CycleEventKind
    cycle_index: int
    controller_time_s: float = float("nan")
    detail: str = ""


@dataclass(frozen=True, slots=True)
class StateChange:
    """The run went from one state to another."""

    host_ns: int
    state: RunState
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LogEntry:
    """A sentence for whoever reads the recording later: link events, warnings, alarms."""

    host_ns: int
    severity: Severity
    name: str
    """Who says it: `robot`, `tracker`, `recorder`, `run`."""
    text: str


@dataclass(frozen=True, slots=True)
class RecorderStats:
    """What became of the records of one topic since the run began."""

    host_ns: int
    topic: str
    received: int
    """Handed to the recorder: written, dropped or still waiting."""
    enqueued: int
    """Received and taken into its queue, the recorder's own included; -1 in a file that does not say it."""
    written: int
    dropped: int
    """Received, and neither written nor waiting: the queue was full, or the file failed."""
    missed: int
    """Never received: gaps in the device's sequence."""
    queue_high_water: int
    """Most records that ever waited in the recorder's queue."""
    sync_ms: float
    """Longest flush and fdatasync so far, milliseconds."""


Record = RobotState | TrackerFrame | ClockSample | CycleEvent | StateChange | LogEntry | RecorderStats


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """What a device says of itself when it is opened; written into the run file."""

    device: str
    """`robot` or `tracker`."""
    kind: str
    address: str
    version: str = ""
    rate_hz: float = float("nan")
    bodies: dict[int, str] = field(default_factory=dict)
    """Names of the tracker's rigid bodies by their id."""
    detail: dict[str, str] = field(default_factory=dict)
