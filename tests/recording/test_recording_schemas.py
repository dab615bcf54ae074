from __future__ import annotations

import dataclasses
import re
from enum import IntEnum

import pytest
from mcap_ros2._dynamic import generate_dynamic
from recording_examples import one_of_each

from bench.errors import RecordingError
from bench.model import ClockSource, CycleEventKind, RobotState, Severity, StampKind
from bench.recording.messages.cdr import CdrError, Layout, decode, encode
from bench.recording.messages.schemas import load_schema, parse_schema
from bench.recording.messages.topics import TOPICS, encode_record


@pytest.mark.parametrize(
    ("schema", "enum"),
    [
        ("bench_msgs/msg/TrackerFrame", StampKind),
        ("bench_msgs/msg/ClockSample", ClockSource),
        ("bench_msgs/msg/CycleEvent", CycleEventKind),
    ],
)
def test_constants_in_the_definitions_are_the_models_own(schema: str, enum: type[IntEnum]) -> None:
    constants = dict(re.findall(r"^uint8 (\w+) *= *(\d+)", load_schema(schema).text, re.MULTILINE))
    assert {name: int(value) for name, value in constants.items()} == {e.name: e.value for e in enum}


def test_log_levels_are_those_of_ros() -> None:
    constants = dict(re.findall(r"^byte (\w+) *= *(\d+)", load_schema("rcl_interfaces/msg/Log").text, re.MULTILINE))
    assert all(int(constants[severity.name]) == severity for severity in Severity)


def test_every_field_of_a_robot_state_is_in_its_message() -> None:
    recorded = {field.name for field in load_schema("bench_msgs/msg/RobotState").fields}
    assert recorded == {field.name for field in dataclasses.fields(RobotState)}


def test_every_field_of_our_own_messages_says_what_it_is() -> None:
    for topic in TOPICS.values():
        if topic.schema.startswith("bench_msgs"):
            lines = load_schema(topic.schema).text.splitlines()
            assert lines[0].startswith("# "), topic.schema
            bare = [line for line in lines if line.startswith(("int64 ", "float64")) and "#" not in line]
            assert bare in ([], ["float64[4] quaternion_xyzw"]), topic.schema


def test_a_layout_knows_where_every_number_stands() -> None:
    layout = Layout.of(load_schema("bench_msgs/msg/RobotState"))
    assert layout.size == layout.packer.size == layout.dtype.itemsize
    assert layout.offset_of("arrival_ns") == 4
    assert layout.dtype["q_rad"].shape == (6,)


@pytest.mark.parametrize("topic", TOPICS)
def test_an_empty_message_is_decoded_by_an_independent_decoder(topic: str) -> None:
    schema = load_schema(TOPICS[topic].schema)
    theirs = generate_dynamic(schema.name, schema.text)[schema.name](encode(schema, {}))
    for path, value in decode(schema, encode(schema, {})).items():
        target = theirs
        for name in path.split("."):
            target = getattr(target, name)
        assert (list(target) if isinstance(value, (tuple, bytes)) else target) == (
            list(value) if isinstance(value, (tuple, bytes)) else value
        ), path


def test_a_message_cut_anywhere_is_refused_and_never_a_crash() -> None:
    for record in one_of_each():
        for message in encode_record(record):
            schema = load_schema(TOPICS[message.topic].schema)
            for end in range(len(message.payload) - 1):
                with pytest.raises(CdrError):
                    decode(schema, message.payload[:end])


def test_big_endian_messages_are_refused() -> None:
    with pytest.raises(CdrError, match="little-endian"):
        decode(load_schema("bench_msgs/msg/StateChange"), b"\0\0\0\0" + bytes(32))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("Loop again", "uses x/Loop"),
        ("x/A again", "contains itself"),
        ("float64[1000000000] a", "array of 1000000000"),
        ("12 monkeys", "no field"),
        ("other/Thing thing", "does not define"),
    ],
)
def test_a_definition_that_cannot_be_meant_is_refused(text: str, reason: str) -> None:
    with pytest.raises(RecordingError, match=reason):
        parse_schema("x/msg/A", text)


def test_defaults_bounds_and_constants_are_understood() -> None:
    schema = parse_schema("x/msg/A", "int32 a 5\nstring<=10 b\nuint8[<=3] c\nint32 D=7\nint32[2] e # f g\n\n# h\n")
    assert [(f.name, f.type, f.length) for f in schema.fields] == [
        ("a", "int32", None),
        ("b", "string", None),
        ("c", "uint8", -1),
        ("e", "int32", 2),
    ]
