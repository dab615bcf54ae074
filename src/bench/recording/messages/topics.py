"""Which record becomes which message on which topic, with which times and sequence number.

``log_time`` is the arrival, ``publish_time`` the capture mapped to host time (for events both are the moment of the
event), ``sequence`` the device's own number, so that any MCAP tool shows gaps. Where there is no such number the
recorder counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from operator import attrgetter
from typing import Any, NamedTuple

from bench.model import (
    ClockSample,
    CycleEvent,
    LogEntry,
    Record,
    RecorderStats,
    RigidBody,
    RobotState,
    StateChange,
    TrackerFrame,
)
from bench.recording.messages.cdr import HEADER, Layout, encode
from bench.recording.messages.pointcloud import CLOUD_SCHEMA, encode_cloud, split_stamp
from bench.recording.messages.schemas import load_schema

__all__ = [
    "BODIES",
    "CLOCK",
    "CYCLE",
    "FRAME",
    "LOG",
    "POINTS",
    "ROBOT",
    "STATE",
    "STATS",
    "TOPICS",
    "Message",
    "Topic",
    "count_messages",
    "encode_record",
]

ROBOT = "/robot/state"
POINTS = "/tracker/points"
FRAME = "/tracker/frame"
BODIES = "/tracker/bodies"
CYCLE = "/cycle/event"
CLOCK = "/clock/sample"
STATE = "/run/state"
LOG = "/log"
STATS = "/bench/stats"


@dataclass(frozen=True, slots=True)
class Topic:
    """One channel of the run file."""

    name: str
    schema: str
    columns: Mapping[str, str] = field(default_factory=dict)
    """Columns that are called otherwise than the message's fields, by the field."""


TOPICS: Mapping[str, Topic] = {
    topic.name: topic
    for topic in (
        Topic(ROBOT, "bench_msgs/msg/RobotState"),
        Topic(POINTS, CLOUD_SCHEMA),
        Topic(FRAME, "bench_msgs/msg/TrackerFrame"),
        Topic(BODIES, "bench_msgs/msg/RigidBodyPose"),
        Topic(CYCLE, "bench_msgs/msg/CycleEvent"),
        Topic(CLOCK, "bench_msgs/msg/ClockSample"),
        Topic(STATE, "bench_msgs/msg/StateChange"),
        Topic(LOG, "rcl_interfaces/msg/Log", {"level": "severity", "msg": "text"}),
        Topic(STATS, "bench_msgs/msg/RecorderStats"),
    )
}
"""Every topic of a run file, in the order of their channels."""


class Message(NamedTuple):
    """One message, ready for the file."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int | None
    """None where the recorder counts."""
    payload: bytes


def encode_record(record: Record) -> list[Message]:
    """Turn a record into its messages.

    Raises
    ------
    ValueError, struct.error
        A value does not fit its field. The record cannot be written.
    """
    return _ENCODERS[type(record)](record)


def count_messages(record: Record) -> list[tuple[str, int]]:
    """Return how many messages on which topics `encode_record` makes of a record."""
    if isinstance(record, TrackerFrame):
        return [(POINTS, 1), (FRAME, 1), (BODIES, len(record.bodies))]
    topic = _TOPIC_OF.get(type(record))
    return [] if topic is None else [(topic, 1)]


class _FixedEncoder:
    """Packs messages that have always the same size."""

    def __init__(self, topic: str) -> None:
        layout = Layout.of(load_schema(TOPICS[topic].schema))
        self._packer = layout.packer
        self._arrays = [leaf.count is not None for leaf in layout.leaves]
        self._has_arrays = any(self._arrays)
        self._paths = [leaf.path for leaf in layout.leaves]
        self._attributes = attrgetter(*self._paths)

    def pack_record(self, record: object) -> bytes:
        """Pack a record whose attributes are called as the message's fields."""
        return self._pack(self._attributes(record))

    def pack_values(self, values: Mapping[str, Any]) -> bytes:
        return self._pack([values[path] for path in self._paths])

    def _pack(self, values: Iterable[Any]) -> bytes:
        if not self._has_arrays:
            return self._packer.pack(HEADER, *values)
        flat: list[Any] = [HEADER]
        for is_array, value in zip(self._arrays, values, strict=True):
            if is_array:
                flat.extend(value)
            else:
                flat.append(value)
        return self._packer.pack(*flat)


_ROBOT = _FixedEncoder(ROBOT)
_CLOCK = _FixedEncoder(CLOCK)
_FRAME = _FixedEncoder(FRAME)
_BODY = _FixedEncoder(BODIES)


def _encode_robot(state: RobotState) -> list[Message]:
    return [Message(ROBOT, state.arrival_ns, state.capture_ns, state.sequence, _ROBOT.pack_record(state))]


def _encode_clock(sample: ClockSample) -> list[Message]:
    return [Message(CLOCK, sample.receive_ns, sample.receive_ns, None, _CLOCK.pack_record(sample))]


def _encode_frame(frame: TrackerFrame) -> list[Message]:
    times = (frame.arrival_ns, frame.capture_ns, frame.frame_number)
    messages = [Message(POINTS, *times, encode_cloud(frame)), Message(FRAME, *times, _pack_frame(frame))]
    if frame.bodies:
        messages.extend(Message(BODIES, *times, _pack_body(frame.frame_number, body)) for body in frame.bodies)
    return messages


def _pack_frame(frame: TrackerFrame) -> bytes:
    return _FRAME.pack_values(
        {
            "arrival_ns": frame.arrival_ns,
            "capture_ns": frame.capture_ns,
            "frame_number": frame.frame_number,
            "device_ticks": frame.device_ticks,
            "segment": frame.segment,
            "n_points": len(frame.points_m),
            "n_bodies": len(frame.bodies),
            "ptp_seconds": frame.ptp_seconds,
            "ptp_fraction": frame.ptp_fraction,
            "stamp": frame.stamp,
        }
    )


def _pack_body(frame_number: int, body: RigidBody) -> bytes:
    return _BODY.pack_values(
        {
            "frame_number": frame_number,
            "position_m": body.position_m,
            "quaternion_xyzw": body.quaternion_xyzw,
            "mean_error_m": body.mean_error_m,
            "body_id": body.body_id,
            "tracking_valid": body.tracking_valid,
        }
    )


def _encode_cycle(event: CycleEvent) -> list[Message]:
    values = {
        "host_ns": event.host_ns,
        "cycle_index": event.cycle_index,
        "controller_time_s": event.controller_time_s,
        "kind": int(event.kind),
        "detail": event.detail,
    }
    return [_encode_event(CYCLE, event.host_ns, values)]


def _encode_state(change: StateChange) -> list[Message]:
    values = {"host_ns": change.host_ns, "state": str(change.state), "reason": change.reason}
    return [_encode_event(STATE, change.host_ns, values)]


def _encode_log(entry: LogEntry) -> list[Message]:
    sec, nanosec = split_stamp(entry.host_ns)
    values = {
        "stamp": {"sec": sec, "nanosec": nanosec},
        "level": int(entry.severity),
        "name": entry.name,
        "msg": entry.text,
    }
    return [_encode_event(LOG, entry.host_ns, values)]


def _encode_stats(stats: RecorderStats) -> list[Message]:
    return [_encode_event(STATS, stats.host_ns, asdict(stats))]


def _encode_event(topic: str, host_ns: int, values: Mapping[str, Any]) -> Message:
    return Message(topic, host_ns, host_ns, None, encode(load_schema(TOPICS[topic].schema), values))


_ENCODERS: Mapping[type, Callable[[Any], list[Message]]] = {
    RobotState: _encode_robot,
    TrackerFrame: _encode_frame,
    ClockSample: _encode_clock,
    CycleEvent: _encode_cycle,
    StateChange: _encode_state,
    LogEntry: _encode_log,
    RecorderStats: _encode_stats,
}

_TOPIC_OF: Mapping[type, str] = {
    RobotState: ROBOT,
    ClockSample: CLOCK,
    CycleEvent: CYCLE,
    StateChange: STATE,
    LogEntry: LOG,
    RecorderStats: STATS,
}
