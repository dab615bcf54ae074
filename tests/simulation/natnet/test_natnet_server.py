"""The simulated tracker on the wire, with a clock that stands still unless it is moved."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest
from natnet_bench import TICKS_PER_S, RawClient, StillTracker, make_server, still_tracker

from bench.drivers.tracker.natnet.frame import HAS_MODEL, Frame, decode_frame
from bench.drivers.tracker.natnet.messages import (
    ConnectRequest,
    decode_echo_response,
    decode_number,
    decode_server_info,
    decode_text,
    encode_connect,
    encode_echo_request,
    encode_request,
)
from bench.drivers.tracker.natnet.models import MarkerSetModel, RigidBodyModel, decode_models
from bench.drivers.tracker.natnet.wire import Message, encode_packet
from bench.errors import ConnectError

HOST = "127.0.32.11"
KEEPALIVE = encode_packet(Message.KEEPALIVE)


@pytest.fixture
def tracker() -> Iterator[StillTracker]:
    with still_tracker(HOST) as still:
        yield still


@pytest.fixture
def client(tracker: StillTracker) -> Iterator[RawClient]:
    with RawClient(tracker.server.address) as raw:
        yield raw


def connect(client: RawClient, bitstream: tuple[int, ...] | None = None) -> None:
    assert client.ask(encode_connect(ConnectRequest("test", bitstream=bitstream)))[0] == Message.SERVERINFO


def receive_frame(client: RawClient, version: tuple[int, int] = (4, 1)) -> Frame:
    message, payload = client.receive()
    assert message == Message.FRAMEOFDATA
    return decode_frame(payload, version)


@pytest.mark.parametrize("payload", [b"", b"Ping\0", bytes(264), bytes(270), bytes(271)])
@pytest.mark.parametrize("size", [None, 0, 1])
def test_a_connect_of_any_length_is_answered(client: RawClient, payload: bytes, size: int | None) -> None:
    header = struct.pack("<HH", Message.CONNECT, len(payload) if size is None else size)
    message, answer = client.ask(header + payload)
    assert message == Message.SERVERINFO
    info = decode_server_info(answer)
    assert info.natnet_version == (4, 1, 0, 0)
    assert info.clock_hz == TICKS_PER_S
    assert info.data_port == 1511
    assert not info.is_multicast


def test_a_discovery_is_answered_without_making_a_client(tracker: StillTracker, client: RawClient) -> None:
    assert client.ask(encode_connect(ConnectRequest(), Message.DISCOVERY))[0] == Message.SERVERINFO
    tracker.let_pass(0.1)
    assert client.hears_nothing()


def test_exposures_happen_whether_or_not_anyone_listens(tracker: StillTracker) -> None:
    tracker.let_pass(1.0)
    assert tracker.server.n_exposed == pytest.approx(100, abs=1)
    assert tracker.server.n_sent == 0
    assert min(tracker.scene.exposures) == 1042


def test_exposures_are_full_periods_of_the_trackers_own_clock(tracker: StillTracker) -> None:
    tracker.let_pass(1.0)
    ticks = np.array([tracker.tracker_clock.ticks_at(ns) for ns in tracker.scene.host_ns.values()])
    periods = ticks * 100.0 / TICKS_PER_S
    assert np.abs(periods - np.rint(periods)).max() * TICKS_PER_S / 100.0 <= 1.0
    assert np.array_equal(np.diff(np.rint(periods)), np.ones(len(ticks) - 1))


def test_a_frame_says_what_the_scene_showed(tracker: StillTracker, client: RawClient) -> None:
    connect(client)
    tracker.let_pass(0.2)
    frame = receive_frame(client)
    shown = tracker.scene.exposures[frame.frame_number]
    assert np.array_equal(frame.labeled["position_m"], shown.points_m)
    assert np.array_equal(frame.labeled["id"], shown.ids)
    assert np.array_equal(frame.labeled["params"], shown.flags)
    assert np.array_equal(frame.labeled["residual_m"], shown.residual_m)
    assert np.array_equal(frame.other_m, shown.points_m[(shown.flags & HAS_MODEL) != 0])
    assert frame.bodies["id"].tolist() == [4]
    assert frame.bodies["params"].tolist() == [1]
    assert frame.bodies["position_m"].tolist() == [[1.0, 2.0, 3.0]]
    assert frame.bodies["quaternion"].tolist() == [[0.0, 0.0, 0.0, 1.0]]


def test_the_stamps_are_exposure_reception_and_transmission_in_ticks(tracker: StillTracker, client: RawClient) -> None:
    connect(client)
    tracker.let_pass(0.2)
    frame = receive_frame(client)
    exposed_ns = tracker.scene.host_ns[frame.frame_number]
    stamps = np.array([frame.mid_exposure, frame.data_received, frame.transmit])
    after_s = (stamps - tracker.tracker_clock.ticks_at(exposed_ns)) / TICKS_PER_S
    np.testing.assert_allclose(after_s, [0.0, 0.0046, 0.00541], atol=1e-3)
    assert abs(after_s[0]) < 1e-4


def test_a_frame_is_sent_after_its_transmit_time(tracker: StillTracker, client: RawClient) -> None:
    connect(client)
    while tracker.server.n_exposed == 0:
        tracker.let_pass(0.001)
    exposed_ns = tracker.scene.host_ns[1042]
    tracker.let_pass((exposed_ns + 5_400_000 - tracker.clock.now_ns()) * 1e-9)
    assert client.hears_nothing()
    tracker.let_pass(0.006)
    assert receive_frame(client).frame_number == 1042


def test_usb_cameras_send_no_mid_exposure_stamp() -> None:
    with still_tracker(HOST, usb_cameras=True) as tracker, RawClient(tracker.server.address) as client:
        connect(client)
        tracker.let_pass(0.1)
        frame = receive_frame(client)
        assert frame.mid_exposure == 0
        assert frame.data_received > 0


def test_several_clients_get_every_frame_each_in_its_version(tracker: StillTracker, client: RawClient) -> None:
    with RawClient(tracker.server.address) as other:
        connect(client)
        connect(other, (3, 0))
        tracker.let_pass(1.0)
        n = tracker.server.n_sent // 2
        assert n >= 98
        new = [receive_frame(client) for _ in range(n)]
        old = [receive_frame(other, (3, 0)) for _ in range(n)]
    assert [f.frame_number for f in new] == [f.frame_number for f in old]
    assert all(np.array_equal(a.labeled, b.labeled) for a, b in zip(new, old, strict=True))


@pytest.mark.parametrize("version", [(3, 0), (3, 1), (4, 0), (4, 1), (4, 2), (4, 3)])
def test_every_version_can_be_simulated(version: tuple[int, int]) -> None:
    name = f"{version[0]}.{version[1]}"
    with still_tracker(HOST, natnet_version=name) as tracker, RawClient(tracker.server.address) as client:
        connect(client, (4, 3))
        tracker.let_pass(0.1)
        assert len(receive_frame(client, version).labeled) == 12
        drain(client)
        _, models = client.ask(encode_packet(Message.REQUEST_MODELDEF))
        assert isinstance(decode_models(models, version)[0], RigidBodyModel)


def drain(client: RawClient) -> None:
    while not client.hears_nothing():
        pass


def test_the_model_definitions_name_the_bodies_and_their_markers(client: RawClient) -> None:
    message, payload = client.ask(encode_packet(Message.REQUEST_MODELDEF))
    assert message == Message.MODELDEF
    body, own_set, everything = decode_models(payload, (4, 1))
    assert isinstance(body, RigidBodyModel)
    assert (body.body_id, body.name) == (4, "clamp")
    assert np.array_equal(body.markers_m, np.arange(9.0).reshape(3, 3))
    assert own_set == MarkerSetModel("clamp", ("Marker1", "Marker2", "Marker3"))
    assert everything == MarkerSetModel("all", ("clamp_1", "clamp_2", "clamp_3"))


@pytest.mark.parametrize(
    ("request_", "layout", "value"),
    [("FrameRate", "<f", 100.0), ("UnitsToMillimeters", "<f", 1000.0), ("UpAxis", "<i", 1), ("LiveMode", "<i", 0)],
)
def test_requests_are_answered_with_a_number(client: RawClient, request_: str, layout: str, value: float) -> None:
    message, payload = client.ask(encode_request(request_))
    assert message == Message.RESPONSE
    assert decode_number(payload, struct.Struct(layout)) == value


def test_an_unknown_request_is_answered_with_itself(client: RawClient) -> None:
    message, payload = client.ask(encode_request("TestRequest"))
    assert message == Message.UNRECOGNIZED_REQUEST
    assert decode_text(payload) == "TestRequest"
    assert client.ask(encode_packet(Message.MODELDEF))[0] == Message.UNRECOGNIZED_REQUEST


def test_the_bitstream_version_can_be_changed_and_asked(tracker: StillTracker, client: RawClient) -> None:
    connect(client)
    assert decode_text(client.ask(encode_request("Bitstream"))[1]) == "Bitstream,4.1"
    assert client.ask(encode_request("Bitstream,3.1"))[1] == struct.pack("<i", 0)
    assert decode_text(client.ask(encode_request("Bitstream"))[1]) == "Bitstream,3.1"
    assert client.ask(encode_request("Bitstream,x"))[1] == struct.pack("<i", 1)
    assert client.ask(encode_request("Bitstream,9.9"))[1] == struct.pack("<i", 1)


def test_the_recording_bit_follows_the_requests(tracker: StillTracker, client: RawClient) -> None:
    connect(client)
    client.ask(encode_request("StartRecording"))
    tracker.let_pass(0.02)
    assert receive_frame(client).params == 1
    drain(client)
    client.ask(encode_request("StopRecording"))
    tracker.let_pass(0.05)
    frames = [receive_frame(client)]
    while not client.hears_nothing():
        frames.append(receive_frame(client))
    assert frames[-1].params == 0


def test_the_newest_frame_can_be_asked_for(tracker: StillTracker, client: RawClient) -> None:
    tracker.let_pass(0.5)
    message, payload = client.ask(encode_packet(Message.REQUEST_FRAMEOFDATA))
    assert message == Message.FRAMEOFDATA
    newest = max(tracker.scene.exposures)
    assert newest - 1 <= decode_frame(payload, (4, 1)).frame_number <= newest


def test_an_echo_tells_the_trackers_clock(tracker: StillTracker, client: RawClient) -> None:
    tracker.let_pass(10.0)
    message, payload = client.ask(encode_echo_request(12_345))
    assert message == Message.ECHORESPONSE
    assert decode_echo_response(payload) == (12_345, tracker.tracker_clock.ticks_at(tracker.clock.now_ns()))


def test_garbage_is_survived(tracker: StillTracker, client: RawClient) -> None:
    for packet in (b"", b"x", b"\x0c\x00\x08\x00abc", b"\x02\x00\xff\xff", bytes(5000)):
        client.send(packet)
    heard = [client.ask(encode_echo_request(1))[0]]
    while heard[-1] != Message.ECHORESPONSE:
        heard.append(client.receive()[0])
    assert set(heard) <= {Message.ECHORESPONSE, Message.UNRECOGNIZED_REQUEST, Message.SERVERINFO}


def test_a_client_that_falls_silent_is_dropped_after_ten_seconds(tracker: StillTracker, client: RawClient) -> None:
    with RawClient(tracker.server.address) as faithful:
        connect(client)
        connect(faithful)
        for _ in range(3):
            tracker.let_pass(4.0)
            drain(faithful)
            faithful.send(KEEPALIVE)
            settle(faithful)
            drain(client)
            settle(client)
        tracker.let_pass(0.1)
        assert client.hears_nothing()
        assert not faithful.hears_nothing()


def settle(client: RawClient) -> None:
    """Wait until the server has read everything sent so far, and has looked at its clients after that."""
    for _ in range(2):
        while client.ask(encode_echo_request(1))[0] != Message.ECHORESPONSE:
            pass


def test_a_client_that_takes_its_leave_gets_no_more_frames(tracker: StillTracker, client: RawClient) -> None:
    connect(client)
    client.send(encode_packet(Message.DISCONNECT))
    settle(client)
    tracker.let_pass(0.2)
    assert client.hears_nothing()


def test_a_keepalive_makes_no_client(tracker: StillTracker, client: RawClient) -> None:
    client.send(KEEPALIVE)
    settle(client)
    tracker.let_pass(0.2)
    assert client.hears_nothing()


def test_frames_that_the_network_refuses_are_counted(tracker: StillTracker) -> None:
    tracker.server._clients.add(("255.255.255.255", 9), (4, 1))  # broadcast is not allowed on the socket
    tracker.let_pass(0.1)
    assert tracker.server.n_unsent > 0
    assert tracker.server.n_sent == 0


def test_an_address_in_use_is_told(tracker: StillTracker) -> None:
    host, port = tracker.server.address
    second = make_server(
        host, tracker.scene, tracker.scheduler, tracker.clock, tracker.tracker_clock, command_port=port
    )
    with pytest.raises(ConnectError, match=rf"{port}.*already in use"):
        second.open()
    second.close()


def test_a_foreign_address_is_told(tracker: StillTracker) -> None:
    foreign = make_server("192.0.2.1", tracker.scene, tracker.scheduler, tracker.clock, tracker.tracker_clock)
    with pytest.raises(ConnectError, match="cannot be used"):
        foreign.open()


def test_after_closing_nothing_is_exposed_or_sent(tracker: StillTracker) -> None:
    tracker.let_pass(0.1)
    n = tracker.server.n_exposed
    tracker.server.close()
    tracker.server.close()
    tracker.let_pass(0.5)
    assert tracker.server.n_exposed == n
