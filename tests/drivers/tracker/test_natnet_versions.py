"""The oldest versions, which know less, and those to come, which know more."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from natnet_recording import packets_of, stored

from bench.drivers.tracker.natnet.bitstream import DOUBTFUL_FAILURES, Bitstream
from bench.drivers.tracker.natnet.frame import BITSTREAM_CHANGED, NO_STAMP, Frame, Section, decode_frame, encode_frame
from bench.drivers.tracker.natnet.models import RigidBodyModel, decode_models, encode_models
from bench.drivers.tracker.natnet.records import capture_stamp
from bench.drivers.tracker.natnet.wire import Message
from bench.errors import ProtocolError
from bench.model import StampKind

V3 = (3, 0)
OLD = [(2, 9), (2, 10), (2, 11)]
NEWER = [(4, 4), (4, 5), (5, 1)]


def real_frame(index: int = 0) -> Frame:
    return decode_frame(packets_of(Message.FRAMEOFDATA)[index][4:], V3)


def old_frame() -> Frame:
    markers = Section(5, bytes(range(100)))
    return replace(real_frame(), body_markers=(markers,), latency_s=0.005, timestamp_s=1356.125)


@pytest.mark.parametrize("version", OLD)
def test_an_old_frame_is_encoded_to_the_same_bytes(version: tuple[int, int]) -> None:
    packet = encode_frame(old_frame(), version)
    again = decode_frame(packet[4:], version)
    assert encode_frame(again, version) == packet
    assert again.body_markers == old_frame().body_markers


@pytest.mark.parametrize("version", OLD)
def test_an_old_frame_has_the_points_and_bodies_but_no_residuals(version: tuple[int, int]) -> None:
    new, old = real_frame(), decode_frame(encode_frame(old_frame(), version)[4:], version)
    for field in ("id", "position_m", "size_m", "params"):
        assert np.array_equal(old.labeled[field], new.labeled[field])
    assert np.isnan(old.labeled["residual_m"]).all()
    assert np.array_equal(old.bodies, new.bodies)
    assert np.array_equal(old.other_m, new.other_m)


def test_an_old_frame_is_laid_out_as_the_facts_say() -> None:
    frame = replace(old_frame(), marker_sets=(), other_m=np.zeros((0, 3), np.float32))
    body, point = frame.bodies[:1].tobytes(), frame.labeled[:1].tobytes()
    expected = struct.pack("<4i", 7, 0, 0, 1) + body[:32] + struct.pack("<i", 5) + bytes(range(100)) + body[32:]
    expected += struct.pack("<2i", 0, 1) + point[:22] + struct.pack("<i", 0)
    expected += struct.pack("<fIIdHi", frame.latency_s, 0, 0, 1356.125, frame.params, 0)
    frame = replace(frame, frame_number=7, labeled=frame.labeled[:1])
    assert encode_frame(frame, (2, 10))[4:] == expected


def test_the_stamp_of_an_old_frame_is_its_time_since_the_start_of_the_software() -> None:
    frame = decode_frame(encode_frame(old_frame(), (2, 10))[4:], (2, 10))
    assert (frame.mid_exposure, frame.data_received, frame.transmit) == (NO_STAMP,) * 3
    assert capture_stamp(frame) == (1_356_125_000_000, StampKind.TRACKER_TIME)


@pytest.mark.parametrize("timestamp_s", [0.0, -1.0, float("nan"), float("inf"), 1e300])
def test_an_old_frame_without_a_time_is_refused(timestamp_s: float) -> None:
    frame = decode_frame(encode_frame(replace(old_frame(), timestamp_s=timestamp_s), (2, 10))[4:], (2, 10))
    with pytest.raises(ProtocolError, match="no camera stamp"):
        capture_stamp(frame)


def test_an_old_frame_with_a_byte_too_many_is_refused() -> None:
    with pytest.raises(ProtocolError, match="7 bytes after its stamps; 6 are due"):
        decode_frame(encode_frame(old_frame(), (2, 10))[4:] + b"\0", (2, 10))


def test_old_model_definitions_do_not_tell_the_markers_of_a_body() -> None:
    models = decode_models(stored("modeldef_packet_v3")[4:], V3)
    packet = encode_models(models, (2, 10))
    body, *_ = decode_models(packet[4:], (2, 10))
    assert isinstance(body, RigidBodyModel)
    assert (body.name, body.body_id, body.markers_m.shape) == ("RaceQuad", 2, (0, 3))
    assert encode_models(decode_models(packet[4:], (2, 10)), (2, 10)) == packet


def test_model_definitions_of_a_newer_version_may_be_longer() -> None:
    (body, *_) = decode_models(stored("modeldef_packet_v3")[4:], V3)
    packet = encode_models((body,), (4, 2))
    size = struct.unpack_from("<i", packet, 12)[0]
    longer = packet[4:12] + struct.pack("<i", size + 3) + packet[16:] + b"new"
    (again,) = decode_models(longer, (4, 4))
    assert isinstance(again, RigidBodyModel)
    assert again.name == "RaceQuad"
    with pytest.raises(ProtocolError, match="3 bytes more"):
        decode_models(longer, (4, 2))


sections = st.lists(st.builds(Section, st.integers(0, 9), st.binary(max_size=60)), max_size=3).map(tuple)


@settings(deadline=None, max_examples=300)
@given(
    newer=sections,
    trailing=st.one_of(st.just(b""), st.binary(min_size=1, max_size=40)),
    index=st.integers(0, 517),
    version=st.sampled_from(NEWER),
    ptp=st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1)),
)
def test_sections_and_bytes_of_versions_to_come_are_skipped(
    newer: tuple[Section, ...], trailing: bytes, index: int, version: tuple[int, int], ptp: tuple[int, int]
) -> None:
    frame = replace(real_frame(index), ptp=ptp, params=1)
    payload = encode_frame(replace(frame, newer=newer, trailing=trailing), version)[4:]
    again = decode_frame(payload, version)
    assert (again.timestamp_s, again.mid_exposure, again.transmit) == (
        frame.timestamp_s,
        frame.mid_exposure,
        frame.transmit,
    )
    assert (again.ptp, again.params, again.newer, again.trailing) == (ptp, 1, newer, trailing)
    assert np.array_equal(again.labeled, frame.labeled)
    assert encode_frame(again, version)[4:] == payload


def test_a_known_version_has_nothing_to_skip() -> None:
    for more in ({"newer": (Section(1, b"what"),)}, {"trailing": b"more"}):
        payload = encode_frame(replace(real_frame(), **more), (4, 3))[4:]
        with pytest.raises(ProtocolError, match="bytes after its stamps"):
            decode_frame(payload, (4, 3))


def test_a_multicast_is_read_in_the_servers_version_which_nobody_can_choose() -> None:
    multicast, unicast = (Bitstream((4, 5, 0, 0), may_choose=choice) for choice in (False, True))
    assert (multicast.version, multicast.is_chosen) == ((4, 5), False)
    assert (unicast.version, unicast.is_chosen) == ((4, 1), True)
    frame = replace(real_frame(), newer=(Section(1, b"what"),))
    assert multicast.decode_frame(encode_frame(frame, (4, 5))[4:]).newer == frame.newer


def test_when_no_frame_can_be_read_any_more_the_version_is_in_doubt() -> None:
    bitstream = Bitstream((4, 1, 0, 0))
    bitstream.decode_frame(encode_frame(real_frame(), (4, 1))[4:])
    old = encode_frame(old_frame(), (2, 10))[4:]
    for _ in range(DOUBTFUL_FAILURES - 1):
        with pytest.raises(ProtocolError, match=r"not of version 4\.1, as those before it"):
            bitstream.decode_frame(old)
    assert bitstream.decode_frame(old).timestamp_s == 1356.125
    assert bitstream.version == (2, 10)


def test_the_first_frame_of_another_version_says_so_itself() -> None:
    bitstream = Bitstream((4, 1, 0, 0))
    bitstream.decode_frame(encode_frame(real_frame(), (4, 1))[4:])
    changed = replace(real_frame(), params=BITSTREAM_CHANGED)
    assert bitstream.decode_frame(encode_frame(changed, (3, 0))[4:]).frame_number == changed.frame_number
    bitstream.decode_frame(encode_frame(real_frame(), (3, 0))[4:])


def test_broken_frames_among_good_ones_cast_no_doubt() -> None:
    bitstream = Bitstream((4, 1, 0, 0))
    good, old = encode_frame(real_frame(), (4, 1))[4:], encode_frame(old_frame(), (2, 10))[4:]
    for _ in range(3 * DOUBTFUL_FAILURES):
        bitstream.decode_frame(good)
        with pytest.raises(ProtocolError):
            bitstream.decode_frame(old)
