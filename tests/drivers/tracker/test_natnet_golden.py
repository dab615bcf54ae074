"""The codec against the packets of a real Motive."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from natnet_recording import DATA, packets_of, stored, traffic

from bench.drivers.tracker.natnet.frame import HAS_MODEL, decode_frame, encode_frame
from bench.drivers.tracker.natnet.messages import (
    ServerInfo,
    decode_connect,
    decode_echo_request,
    decode_echo_response,
    decode_number,
    decode_server_info,
    decode_text,
    encode_connect,
    encode_echo_request,
    encode_echo_response,
    encode_number_response,
    encode_request,
    encode_server_info,
)
from bench.drivers.tracker.natnet.models import MarkerSetModel, RigidBodyModel, decode_models, encode_models
from bench.drivers.tracker.natnet.wire import Message, encode_packet, split_packet
from bench.model import UNLABELED

V3 = (3, 0)


def test_the_capture_holds_what_its_readme_says() -> None:
    assert len(traffic()) == 550
    assert len(packets_of(Message.FRAMEOFDATA)) == 518
    assert len(packets_of(Message.ECHORESPONSE)) == 9


def test_every_real_frame_is_encoded_to_the_same_bytes() -> None:
    for packet in packets_of(Message.FRAMEOFDATA):
        assert encode_frame(decode_frame(packet[4:], V3), V3) == packet


@pytest.mark.parametrize("name", ["mocapframe_packet_v3", "mocapframe_packet_occluded_v3"])
def test_stored_frames_are_encoded_to_the_same_bytes(name: str) -> None:
    packet = stored(name)
    assert encode_frame(decode_frame(packet[4:], V3), V3) == packet


@pytest.mark.parametrize("version", [(3, 1), (4, 0), (4, 1), (4, 2), (4, 3)])
def test_a_real_frame_survives_every_version(version: tuple[int, int]) -> None:
    for packet in [*packets_of(Message.FRAMEOFDATA)[:20], stored("mocapframe_packet_occluded_v3")]:
        newer = encode_frame(decode_frame(packet[4:], V3), version)
        assert encode_frame(decode_frame(newer[4:], version), V3) == packet


def encode_again(message: int, payload: bytes) -> bytes:
    """Decode a packet's payload and encode what was understood of it."""
    if message in (Message.CONNECT, Message.DISCOVERY, Message.UNRECOGNIZED_REQUEST):
        return encode_connect(decode_connect(payload), Message(message))
    if message == Message.SERVERINFO:
        return encode_server_info(decode_server_info(payload))
    if message == Message.REQUEST and payload.isascii():  # NaturalPoint's library asks one thing in binary
        return encode_request(decode_text(payload))
    if message == Message.RESPONSE and len(payload) == 4:
        return encode_number_response(decode_number(payload))
    if message == Message.MODELDEF:
        return encode_models(decode_models(payload, V3), V3)
    if message == Message.FRAMEOFDATA:
        return encode_frame(decode_frame(payload, V3), V3)
    if message == Message.ECHOREQUEST:
        return encode_echo_request(decode_echo_request(payload))
    if message == Message.ECHORESPONSE:
        return encode_echo_response(*decode_echo_response(payload))
    return encode_packet(Message(message), payload)


@pytest.mark.parametrize("message", [0, 1, 2, 3, 4, 5, 7, 12, 13, 14, 100])
def test_every_packet_of_the_capture_is_encoded_to_the_same_bytes(message: int) -> None:
    found = packets_of(message)
    assert found
    for packet in found:
        again = encode_again(*split_packet(packet))
        assert again == packet


@pytest.mark.parametrize("path", sorted(DATA.glob("*.bin")), ids=lambda path: path.stem)
def test_every_stored_packet_is_encoded_to_the_same_bytes(path: Path) -> None:
    packet = path.read_bytes()
    assert encode_again(*split_packet(packet)) == packet


def test_the_unlabeled_reflection_is_among_the_labeled_markers_and_the_others_are_the_bodys() -> None:
    for packet in packets_of(Message.FRAMEOFDATA):
        frame = decode_frame(packet[4:], V3)
        loose = frame.labeled[(frame.labeled["params"] & UNLABELED) != 0]
        of_body = frame.labeled[(frame.labeled["params"] & HAS_MODEL) != 0]
        assert loose["id"].tolist() == [50007]
        assert np.array_equal(of_body["position_m"], frame.other_m)


def test_an_occluded_marker_keeps_its_flag() -> None:
    frame = decode_frame(stored("mocapframe_packet_occluded_v3")[4:], V3)
    assert frame.labeled["params"].tolist() == [0x0B, 0x0A, 0x0A, 0x0A]
    assert [one.name for one in frame.marker_sets] == ["FakeTree", "all"]
    assert [len(one.points_m) for one in frame.marker_sets] == [5, 5]


def test_camera_stamps_lie_in_their_order() -> None:
    frames = [decode_frame(packet[4:], V3) for packet in packets_of(Message.FRAMEOFDATA)]
    assert all(f.mid_exposure < f.data_received < f.transmit for f in frames)
    assert np.array_equal(np.diff([f.frame_number for f in frames]), np.ones(517))


def test_model_definitions_are_encoded_to_the_same_bytes() -> None:
    packet = stored("modeldef_packet_v3")
    body, marker_set, everything = decode_models(packet[4:], V3)
    assert isinstance(body, RigidBodyModel)
    assert (body.name, body.body_id, body.markers_m.shape) == ("RaceQuad", 2, (5, 3))
    assert marker_set == MarkerSetModel("RaceQuad", tuple(f"Marker{i}" for i in range(1, 6)))
    assert isinstance(everything, MarkerSetModel)
    assert encode_models((body, marker_set, everything), V3) == packet


@pytest.mark.parametrize("version", [V3, (4, 0), (4, 1), (4, 2)])
def test_model_definitions_survive_every_version(version: tuple[int, int]) -> None:
    models = decode_models(stored("modeldef_packet_v3")[4:], V3)
    again = decode_models(encode_models(models, version)[4:], version)
    assert encode_models(again, V3) == stored("modeldef_packet_v3")


def test_server_info_tells_versions_and_the_clock_frequency() -> None:
    info = decode_server_info(stored("serverinfo_packet_v3")[4:])
    assert info == ServerInfo("Motive", (2, 1, 0, 0), (3, 0, 0, 0), 3_312_787, 1511, True, (239, 255, 42, 99))


def test_a_real_connect_is_encoded_to_the_same_bytes() -> None:
    packet = stored("connect_packet_v3")
    request = decode_connect(packet[4:])
    assert (request.name, request.natnet_version, request.bitstream) == ("NatNetLib", (3, 0, 0, 0), None)
    assert encode_connect(request) == packet
    assert encode_connect(request, Message.DISCOVERY) == stored("discovery_packet_v3")


def test_echoes_are_encoded_to_the_same_bytes() -> None:
    for packet in packets_of(Message.ECHOREQUEST):
        assert encode_echo_request(decode_echo_request(packet[4:])) == packet
    for packet in packets_of(Message.ECHORESPONSE):
        assert encode_echo_response(*decode_echo_response(packet[4:])) == packet


def test_requests_and_their_answers_are_encoded_to_the_same_bytes() -> None:
    asked = {decode_text(packet[4:]): packet for packet in packets_of(Message.REQUEST)}
    assert encode_request("FrameRate") == asked["FrameRate"]
    rate = packets_of(Message.RESPONSE)[1]
    assert decode_number(rate[4:]) == 120.0
    assert encode_number_response(120.0) == rate


def test_an_unknown_request_is_answered_with_message_100_decimal() -> None:
    (packet,) = packets_of(Message.UNRECOGNIZED_REQUEST)
    message, payload = split_packet(packet)
    assert message == Message.UNRECOGNIZED_REQUEST
    assert len(payload) == 264


def test_a_request_for_model_definitions_is_a_header_alone() -> None:
    assert encode_packet(Message.REQUEST_MODELDEF) == stored("requestmodeldef_packet_v3")
    assert struct.calcsize("<HH") == len(stored("requestmodeldef_packet_v3"))
