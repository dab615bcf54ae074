"""The codec against whatever may come: broken packets, newer versions, sloppy clients."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from natnet_recording import packets_of, stored

from bench.drivers.tracker.natnet.bitstream import Bitstream
from bench.drivers.tracker.natnet.frame import (
    BODY,
    LABELED,
    Frame,
    MarkerSet,
    Section,
    decode_frame,
    encode_frame,
)
from bench.drivers.tracker.natnet.messages import (
    ConnectRequest,
    decode_connect,
    decode_echo_request,
    decode_echo_response,
    decode_number,
    decode_server_info,
    decode_text,
    encode_connect,
    encode_unrecognized,
)
from bench.drivers.tracker.natnet.models import OtherModel, RigidBodyModel, decode_models, encode_models
from bench.drivers.tracker.natnet.wire import (
    LARGEST_PACKET,
    Message,
    encode_packet,
    pack_text,
    split_packet,
    verify_whole,
)
from bench.errors import ProtocolError

VERSIONS = [(2, 9), (2, 10), (3, 0), (3, 1), (4, 0), (4, 1), (4, 2), (4, 3), (4, 5), (5, 0)]
V3_FRAMES = [stored("mocapframe_packet_v3"), stored("mocapframe_packet_occluded_v3")]


def decode_v41(payload: bytes) -> Frame:
    return decode_frame(payload, (4, 1))


Decoder = Callable[[bytes], object]
DECODERS: list[tuple[bytes, Decoder]] = [
    *((packet[4:], lambda payload: decode_frame(payload, (3, 0))) for packet in V3_FRAMES),
    *((encode_frame(decode_frame(packet[4:], (3, 0)), (4, 1))[4:], decode_v41) for packet in V3_FRAMES),
    (stored("modeldef_packet_v3")[4:], lambda payload: decode_models(payload, (3, 0))),
    (
        encode_models(decode_models(stored("modeldef_packet_v3")[4:], (3, 0)), (4, 2))[4:],
        lambda payload: decode_models(payload, (4, 2)),
    ),
    (stored("serverinfo_packet_v3")[4:], decode_server_info),
    (stored("connect_packet_v3")[4:], decode_connect),
    (stored("echorequest_packet_v3")[4:], decode_echo_request),
    (stored("echoresponse_packet_v3")[4:], decode_echo_response),
]


def make_frame(n_labeled: int = 3, n_bodies: int = 1, seed: int = 0) -> Frame:
    rng = np.random.default_rng(seed)
    labeled = np.zeros(n_labeled, dtype=LABELED)
    labeled["id"] = rng.integers(0, 2**32, n_labeled)
    labeled["position_m"] = rng.normal(size=(n_labeled, 3))
    labeled["params"] = 0x12
    bodies = np.zeros(n_bodies, dtype=BODY)
    bodies["id"] = np.arange(n_bodies)
    bodies["params"] = 1
    return Frame(
        frame_number=7,
        labeled=labeled,
        bodies=bodies,
        other_m=rng.normal(size=(2, 3)).astype(np.float32),
        timestamp_s=1.25,
        mid_exposure=100,
        data_received=200,
        transmit=300,
        marker_sets=(MarkerSet("cable", np.ones((2, 3), dtype=np.float32)),),
        params=1,
    )


def skeleton(n_bodies: int, version: tuple[int, int]) -> Section:
    body = bytes(32) + struct.pack("<i", 2) + bytes(2 * 20 + 6) if version < (3, 0) else bytes(BODY.itemsize)
    return Section(1, struct.pack("<ii", 5, n_bodies) + body * n_bodies)


def channels() -> Section:
    return Section(2, struct.pack("<iiif", 1, 1, 1, 2.5) + struct.pack("<iii2f", 2, 1, 2, 1.0, 2.0))


@settings(deadline=None, max_examples=300)
@given(st.data())
def test_a_cut_packet_is_a_protocol_error_or_still_makes_sense(data: st.DataObject) -> None:
    payload, decode = data.draw(st.sampled_from(DECODERS))
    size = data.draw(st.integers(0, len(payload) - 1))
    try:
        decode(payload[:size])
    except ProtocolError:
        return
    # A frame whose end is all zeros still ends well without the 8 bytes of its PTP time; `verify_whole` sees that.
    is_frame_without_ptp = decode is decode_v41 and len(payload) - size == 8
    assert is_frame_without_ptp or decode in (decode_connect, decode_server_info)


def test_a_packet_with_fewer_bytes_than_its_header_announces_is_refused() -> None:
    packet = stored("mocapframe_packet_v3")
    verify_whole(packet)
    with pytest.raises(ProtocolError, match="was cut"):
        verify_whole(packet[:-1])


@settings(deadline=None, max_examples=500)
@given(st.data())
def test_flipped_bits_raise_nothing_but_protocol_errors(data: st.DataObject) -> None:
    payload, decode = data.draw(st.sampled_from(DECODERS))
    broken = bytearray(payload)
    for bit in data.draw(st.lists(st.integers(0, len(payload) * 8 - 1), min_size=1, max_size=8)):
        broken[bit // 8] ^= 1 << bit % 8
    with contextlib.suppress(ProtocolError):
        decode(bytes(broken))


@settings(deadline=None, max_examples=300)
@given(st.binary(max_size=200), st.sampled_from(VERSIONS))
def test_garbage_raises_nothing_but_protocol_errors(payload: bytes, version: tuple[int, int]) -> None:
    for decode in (lambda p: decode_frame(p, version), lambda p: decode_models(p, version), decode_server_info):
        with contextlib.suppress(ProtocolError):
            decode(payload)


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 60), st.integers(0, 4), st.integers(0, 2**32 - 1), st.sampled_from(VERSIONS))
def test_frames_survive_the_way_there_and_back(n: int, n_bodies: int, seed: int, version: tuple[int, int]) -> None:
    packet = encode_frame(make_frame(n, n_bodies, seed), version)
    assert encode_frame(decode_frame(packet[4:], version), version) == packet


@pytest.mark.parametrize("version", VERSIONS)
def test_sections_that_bench_does_not_use_are_kept(version: tuple[int, int]) -> None:
    assets = Section(1, bytes(12)) if version >= (4, 1) else Section()
    bones, devices = skeleton(3, version), channels() if version >= (3, 0) else Section()
    frame = replace(make_frame(), skeletons=bones, force_plates=channels(), devices=devices, assets=assets)
    again = decode_frame(encode_frame(frame, version)[4:], version)
    assert (again.skeletons, again.force_plates, again.devices) == (bones, channels(), devices)
    assert again.assets == assets


@pytest.mark.parametrize("version", VERSIONS)
def test_the_ptp_time_is_found_by_the_bytes_that_are_left(version: tuple[int, int]) -> None:
    packet = encode_frame(replace(make_frame(), ptp=(11, 22)), version)
    assert decode_frame(packet[4:], version).ptp == ((11, 22) if version >= (4, 1) else (0, 0))


def test_a_40_frame_with_a_ptp_time_is_read_too() -> None:
    packet = encode_frame(make_frame(), (4, 0))
    with_ptp = packet[4:-6] + struct.pack("<II", 11, 22) + packet[-6:]
    frame = decode_frame(with_ptp, (4, 0))
    assert (frame.ptp, frame.params) == ((11, 22), 1)


def test_a_frame_without_its_four_closing_zeros_is_refused() -> None:
    packet = bytearray(encode_frame(make_frame(), (4, 1)))
    packet[-1] = 1
    with pytest.raises(ProtocolError, match="four zero bytes"):
        decode_frame(bytes(packet[4:]), (4, 1))


def test_an_unknown_newer_section_is_skipped_by_its_size() -> None:
    frame = replace(make_frame(), newer=(Section(3, b"whatever"), Section(0, b"")))
    again = decode_frame(encode_frame(frame, (4, 4))[4:], (4, 4))
    assert again.newer == frame.newer
    assert np.array_equal(again.labeled, frame.labeled)
    assert again.transmit == 300


def test_items_that_a_newer_version_made_larger_are_cut_to_what_we_know() -> None:
    frame = make_frame(n_labeled=2)
    small = struct.pack("<ii", 2, 2 * LABELED.itemsize) + frame.labeled.tobytes()
    large = struct.pack("<ii", 2, 2 * (LABELED.itemsize + 3))
    large += b"".join(item.tobytes() + b"new" for item in frame.labeled)
    payload = encode_frame(frame, (4, 1))[4:].replace(small, large)
    assert np.array_equal(decode_frame(payload, (4, 1)).labeled, frame.labeled)


def test_a_section_smaller_than_its_items_is_refused() -> None:
    frame = make_frame(n_labeled=2)
    sizes = struct.pack("<ii", 2, 2 * LABELED.itemsize)
    payload = encode_frame(frame, (4, 1))[4:].replace(sizes, struct.pack("<ii", 2, LABELED.itemsize))
    with pytest.raises(ProtocolError):
        decode_frame(payload, (4, 1))


@pytest.mark.parametrize("count", [-1, 2**31 - 1])
def test_a_count_beyond_the_packet_is_refused_before_anything_is_allocated(count: int) -> None:
    with pytest.raises(ProtocolError, match="announces"):
        decode_frame(struct.pack("<iii", 1, 0, count) + bytes(100), (3, 0))


def test_a_packet_shorter_than_a_header_is_refused() -> None:
    with pytest.raises(ProtocolError, match="3 bytes"):
        split_packet(b"abc")


def test_the_size_in_the_header_may_be_wrong() -> None:
    assert split_packet(struct.pack("<HH", 12, 0) + bytes(8)) == (12, bytes(8))


def test_what_fits_no_datagram_is_not_encoded() -> None:
    with pytest.raises(ProtocolError, match="does not fit"):
        encode_packet(Message.FRAMEOFDATA, bytes(LARGEST_PACKET))


@pytest.mark.parametrize(
    ("message", "number"),
    [
        ("REQUEST_MODELDEF", 4),
        ("REQUEST_FRAMEOFDATA", 6),
        ("DISCONNECT", 9),
        ("KEEPALIVE", 10),
        ("DISCONNECTBYTIMEOUT", 11),
    ],
)
def test_messages_that_are_a_header_alone(message: str, number: int) -> None:
    packet = encode_packet(Message[message])
    assert packet == struct.pack("<HH", number, 0)
    assert split_packet(packet) == (number, b"")


@pytest.mark.parametrize("text", ["", "Take 3 begins", "Prüfstand läuft"])
def test_a_message_in_words_ends_with_a_zero(text: str) -> None:
    packet = encode_packet(Message.MESSAGESTRING, pack_text(text))
    assert packet[:2] == struct.pack("<H", 8)
    assert packet[-1] == 0
    assert decode_text(split_packet(packet)[1]) == text


@pytest.mark.parametrize("size", [0, 5, 264, 270, 271])
def test_a_connect_of_any_length_in_use_is_understood(size: int) -> None:
    full = encode_connect(ConnectRequest("Ping", (1, 0), (4, 1), (4, 1)))[4:]
    request = decode_connect(full.ljust(271, b"\0")[:size])
    assert request.name == ("Ping" if size else "")
    assert request.bitstream == ((4, 1, 0, 0) if size >= 269 else None)


def test_clients_of_sdk_4_send_270_bytes() -> None:
    assert len(encode_connect(ConnectRequest(bitstream=(4, 1)))[4:]) == 270


def test_an_old_server_info_has_no_clock() -> None:
    assert decode_server_info(stored("serverinfo_packet_v3")[4 : 4 + 264]).clock_hz == 0


def test_a_number_of_another_size_is_refused() -> None:
    with pytest.raises(ProtocolError, match="9 bytes"):
        decode_number(bytes(9))


def test_ticks_beyond_any_clock_are_refused() -> None:
    with pytest.raises(ProtocolError, match="ticks"):
        decode_echo_response(struct.pack("<QQ", 1, 2**63))


def test_an_unknown_request_comes_back_in_264_bytes() -> None:
    packet = encode_unrecognized(b"TestRequest\0")
    assert packet[:4] == struct.pack("<HH", 100, 264)
    assert packet[4:16] == b"TestRequest\0"


def make_body(name: str = "clamp") -> RigidBodyModel:
    return RigidBodyModel(name, 4, np.arange(9, dtype=np.float32).reshape(3, 3))


OTHER_MODELS = {
    "skeleton": OtherModel(2, b"arm\0" + struct.pack("<ii", 1, 0)),
    "force plate": OtherModel(3, struct.pack("<i", 1) + b"serial\0" + bytes(652) + struct.pack("<i", 1) + b"Fx\0"),
    "device": OtherModel(4, struct.pack("<i", 1) + b"daq\0serial\0" + bytes(8) + struct.pack("<i", 1) + b"ch\0"),
    "camera": OtherModel(5, b"cam\0" + bytes(28)),
}


@pytest.mark.parametrize("kind", OTHER_MODELS)
@pytest.mark.parametrize("version", [(2, 10), (3, 0), (4, 1)])
def test_models_that_bench_does_not_use_are_stepped_over(kind: str, version: tuple[int, int]) -> None:
    models = decode_models(encode_models((OTHER_MODELS[kind], make_body()), version)[4:], version)
    assert models[0] == OTHER_MODELS[kind]
    assert isinstance(models[1], RigidBodyModel)
    assert models[1].name == "clamp"


def test_a_model_of_unknown_kind_is_stepped_over_only_where_it_tells_its_size() -> None:
    models = (OtherModel(42, b"?"), make_body())
    assert decode_models(encode_models(models, (4, 1))[4:], (4, 1))[0] == OtherModel(42, b"?")
    with pytest.raises(ProtocolError, match="kind 42"):
        decode_models(encode_models(models, (4, 0))[4:], (4, 0))


@pytest.mark.parametrize(
    ("server", "sent"),
    [
        ((2, 9), (2, 9)),
        ((2, 10), (2, 10)),
        ((2, 10), (3, 0)),
        ((4, 5), (4, 1)),
        ((3, 0), (3, 0)),
        ((3, 1), (3, 1)),
        ((4, 0), (4, 0)),
        ((4, 1), (4, 1)),
        ((4, 3), (4, 1)),
        ((4, 1), (3, 0)),
    ],
)
def test_frames_are_read_in_the_version_that_is_sent(server: tuple[int, int], sent: tuple[int, int]) -> None:
    bitstream = Bitstream((*server, 0, 0))
    frame = make_frame()
    for _ in range(2):
        again = bitstream.decode_frame(encode_frame(frame, sent)[4:])
        assert np.array_equal(again.labeled["position_m"], frame.labeled["position_m"])


def test_once_a_version_is_proven_others_are_refused_until_the_server_says_it_changed() -> None:
    bitstream = Bitstream((4, 1, 0, 0))
    old, new = encode_frame(make_frame(), (4, 0))[4:], encode_frame(make_frame(), (4, 1))[4:]
    bitstream.decode_frame(new)
    with pytest.raises(ProtocolError):
        bitstream.decode_frame(old)
    bitstream.doubt()
    assert bitstream.decode_frame(old).frame_number == 7


def test_garbage_is_of_no_version() -> None:
    with pytest.raises(ProtocolError):
        Bitstream((4, 1, 0, 0)).decode_frame(b"x" * 50)


def test_model_definitions_are_read_in_the_servers_own_version_too() -> None:
    packet = encode_models((make_body(),), (4, 2))
    (model,) = Bitstream((4, 2, 0, 0)).decode_models(packet[4:])
    assert isinstance(model, RigidBodyModel)
    assert model.marker_names == ("Marker1", "Marker2", "Marker3")


def test_real_frames_are_of_version_three() -> None:
    bitstream = Bitstream((3, 0, 0, 0))
    assert bitstream.decode_frame(packets_of(Message.FRAMEOFDATA)[0][4:]).frame_number == 162_734
