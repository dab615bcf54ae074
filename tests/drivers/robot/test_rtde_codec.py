from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.drivers.robot.ur import codec
from bench.drivers.robot.ur.codec import FrameSplitter, PackageType, TextMessage
from bench.drivers.robot.ur.recipe import DATA_TYPES, Recipe
from bench.errors import ProtocolError

KINDS = [int(kind) for kind in PackageType]
NUMBERS = {
    "d": st.floats(allow_nan=False),
    "?": st.booleans(),
    "B": st.integers(0, 2**8 - 1),
    "I": st.integers(0, 2**32 - 1),
    "i": st.integers(-(2**31), 2**31 - 1),
    "Q": st.integers(0, 2**64 - 1),
}
quick = settings(max_examples=60, deadline=None)


# The bytes below are worked out by hand from the tables of the RTDE guide.
@pytest.mark.parametrize(
    ("kind", "payload", "expected"),
    [
        (PackageType.PROTOCOL_VERSION, codec.encode_protocol_version(2), "0005 56 0002"),
        (PackageType.PROTOCOL_VERSION, codec.encode_accepted(True), "0004 56 01"),
        (PackageType.CONTROLLER_VERSION, b"", "0003 76"),
        (
            PackageType.CONTROLLER_VERSION,
            codec.encode_controller_version((5, 15, 0, 126652)),
            "0013 76 00000005 0000000f 00000000 0001eebc",
        ),
        (
            PackageType.SETUP_OUTPUTS,
            codec.encode_output_setup(["timestamp"], 500.0),
            "0014 4f 407f400000000000 74696d657374616d70",
        ),
        (PackageType.SETUP_OUTPUTS, codec.encode_setup_reply(1, ["DOUBLE"]), "000a 4f 01 444f55424c45"),
        (PackageType.SETUP_OUTPUTS, codec.encode_setup_reply(None, ["DOUBLE"]), "0009 4f 444f55424c45"),
        (
            PackageType.SETUP_INPUTS,
            codec.encode_input_setup(["input_int_register_24"]),
            "0018 49 696e7075745f696e745f72656769737465725f3234",
        ),
        (PackageType.START, b"", "0003 53"),
        (PackageType.PAUSE, codec.encode_accepted(False), "0004 50 00"),
        (PackageType.TEXT, codec.encode_text(TextMessage("hot", "J3", 2)), "000b 4d 03 686f74 02 4a33 02"),
    ],
)
def test_packages_have_the_bytes_of_the_protocol_tables(kind, payload, expected):
    assert codec.encode_frame(kind, payload) == bytes.fromhex(expected)


def test_a_data_package_has_the_bytes_of_the_protocol_tables():
    recipe = Recipe(["timestamp", "robot_mode", "actual_digital_input_bits"], ["DOUBLE", "INT32", "UINT64"], 1)
    payload = recipe.encode([61.25, -1, 5])
    assert payload == bytes.fromhex("01 404ea00000000000 ffffffff 0000000000000005")
    assert recipe.decode(payload) == {"timestamp": 61.25, "robot_mode": -1, "actual_digital_input_bits": 5}


def test_outputs_of_protocol_version_1_have_no_recipe_number():
    recipe = Recipe(["runtime_state"], ["UINT32"], None)
    assert recipe.encode([2]) == bytes.fromhex("00000002")
    assert recipe.decode(bytes.fromhex("00000002")) == {"runtime_state": 2}


def _values(kind):
    code, count = DATA_TYPES[kind]
    one = NUMBERS[code]
    return one if count == 1 else st.tuples(*[one] * count)


@st.composite
def recipes_with_values(draw):
    types = draw(st.lists(st.sampled_from(sorted(DATA_TYPES)), min_size=1, max_size=12))
    names = [f"name_{place}" for place in range(len(types))]
    values = [draw(_values(kind)) for kind in types]
    return Recipe(names, types, draw(st.one_of(st.none(), st.integers(1, 255)))), values


@quick
@given(recipes_with_values())
def test_every_recipe_reads_back_what_it_wrote(case):
    recipe, values = case
    payload = recipe.encode(values)
    assert len(payload) == recipe.size
    assert list(recipe.decode(payload).values()) == values
    assert len(recipe.unpack(payload)) == recipe.width


def test_a_missing_number_stays_nan():
    recipe = Recipe(["speed_scaling"], ["DOUBLE"], 1)
    assert math.isnan(recipe.decode(recipe.encode([math.nan]))["speed_scaling"])


def test_a_recipe_refuses_another_length_another_number_and_another_type():
    recipe = Recipe(["timestamp"], ["DOUBLE"], 2)
    with pytest.raises(ProtocolError, match="of 8 bytes came where 9 are due"):
        recipe.unpack(bytes(8))
    with pytest.raises(ProtocolError, match="of recipe 1 came where 2"):
        recipe.unpack(b"\x01" + bytes(8))
    with pytest.raises(ProtocolError, match="the type 'QUATERNION'"):
        Recipe(["pose"], ["QUATERNION"], 1)
    with pytest.raises(ProtocolError, match="setup of 2 names was answered by 1 types"):
        Recipe(["a", "b"], ["DOUBLE"], 1)


@st.composite
def split_streams(draw):
    frames = draw(st.lists(st.tuples(st.sampled_from(KINDS), st.binary(max_size=80)), max_size=10))
    stream = b"".join(codec.encode_frame(kind, payload) for kind, payload in frames)
    cuts = sorted(draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    ends = [*cuts, len(stream)]
    starts = [0, *cuts]
    return frames, [stream[a:b] for a, b in zip(starts, ends, strict=True)]


@quick
@given(split_streams())
def test_frames_survive_any_splitting_and_merging(case):
    frames, pieces = case
    splitter = FrameSplitter()
    assert [frame for piece in pieces for frame in splitter.feed(piece)] == frames


@pytest.mark.parametrize("data", [b"HTTP/1.1 200 OK\r\n", b"\x00\x02\x55", b"\x00\x00\x00", b"Conn"])
def test_a_header_that_cannot_be_is_refused_at_once(data):
    with pytest.raises(ProtocolError, match="no RTDE package"):
        FrameSplitter().feed(data)


@quick
@given(st.binary(max_size=40))
def test_garbage_never_raises_anything_but_a_protocol_error(data):
    readers = [
        codec.decode_accepted,
        codec.decode_controller_version,
        codec.decode_input_setup,
        codec.decode_protocol_version,
        codec.decode_setup_reply,
        codec.decode_text,
        lambda payload: codec.decode_output_setup(payload, 1),
        lambda payload: codec.decode_output_setup(payload, 2),
        FrameSplitter().feed,
        Recipe(["timestamp", "actual_q"], ["DOUBLE", "VECTOR6D"], 1).unpack,
    ]
    for read in readers:
        try:
            read(data)
        except ProtocolError as error:
            assert str(error).endswith(".") or ". " in str(error)


@quick
@given(
    st.lists(st.from_regex(r"[a-z_0-9]{1,30}", fullmatch=True), min_size=1, max_size=20),
    st.floats(1, 500),
    st.booleans(),
)
def test_setups_read_back_with_or_without_the_trailing_comma(names, rate_hz, has_comma):
    comma = b"," if has_comma else b""
    assert codec.decode_output_setup(codec.encode_output_setup(names, rate_hz) + comma, 2) == (rate_hz, names)
    assert codec.decode_output_setup(codec.encode_output_setup(names, None) + comma, 1) == (125.0, names)
    assert codec.decode_input_setup(codec.encode_input_setup(names) + comma) == names
    assert codec.decode_setup_reply(codec.encode_setup_reply(7, names) + comma) == (7, names)


@quick
@given(st.text(max_size=60), st.text(max_size=60), st.integers(0, 255))
def test_text_messages_read_back(text, source, level):
    message = TextMessage(text, source, level)
    assert codec.decode_text(codec.encode_text(message)) == message


def test_versions_read_back():
    assert codec.decode_protocol_version(codec.encode_protocol_version(2)) == 2
    assert codec.decode_controller_version(codec.encode_controller_version((10, 1, 2, 3))) == (10, 1, 2, 3)


def test_a_payload_that_no_frame_can_hold_is_refused():
    with pytest.raises(ValueError, match="65536 bytes"):
        codec.encode_frame(PackageType.TEXT, bytes(65533))


def test_a_number_that_does_not_fit_its_type_is_refused():
    with pytest.raises(struct.error):
        Recipe(["input_int_register_24"], ["INT32"], 1).pack((2**31,))
