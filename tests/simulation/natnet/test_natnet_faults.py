"""The simulated tracker restarts, changes and stutters on command."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import numpy as np
import pytest
from natnet_bench import TICKS_PER_S, RawClient, StillTracker, still_tracker

from bench.drivers.tracker.natnet.frame import BITSTREAM_CHANGED, MODELS_CHANGED, Frame, decode_frame
from bench.drivers.tracker.natnet.messages import (
    ConnectRequest,
    decode_echo_response,
    decode_server_info,
    decode_text,
    encode_connect,
    encode_echo_request,
    encode_request,
)
from bench.drivers.tracker.natnet.models import RigidBodyModel, decode_models
from bench.drivers.tracker.natnet.wire import LARGEST_PACKET, Message, encode_packet, split_packet

HOST = "127.0.32.41"
GROUP = "239.255.42.98"
DATA_PORT = 15_112


@pytest.fixture
def tracker() -> Iterator[StillTracker]:
    with still_tracker(HOST) as still:
        yield still


@pytest.fixture
def client(tracker: StillTracker) -> Iterator[RawClient]:
    with RawClient(tracker.server.address) as raw:
        raw.ask(encode_connect(ConnectRequest("test")))
        yield raw


def frames(client: RawClient, version: tuple[int, int] = (4, 1)) -> list[Frame]:
    """Return all that has arrived."""
    found = []
    client.socket.setblocking(False)
    while True:
        try:
            message, payload = split_packet(client.socket.recv(LARGEST_PACKET))
        except BlockingIOError:
            client.socket.settimeout(20.0)
            return found
        if message == Message.FRAMEOFDATA:
            found.append(decode_frame(payload, version))


def test_a_restart_begins_another_clock_and_other_frame_numbers_and_forgets_everyone(
    tracker: StillTracker, client: RawClient
) -> None:
    tracker.let_pass(1.0)
    before = frames(client)
    client.ask(encode_request("StartRecording"))
    tracker.server.restart()
    tracker.let_pass(0.5)
    assert frames(client) == []
    client.ask(encode_connect(ConnectRequest("test")))
    tracker.let_pass(0.5)
    after = frames(client)
    assert after[0].frame_number < before[0].frame_number
    assert np.array_equal(np.diff([frame.frame_number for frame in after]), np.ones(len(after) - 1))
    assert after[0].mid_exposure / TICKS_PER_S == pytest.approx(45.5, abs=0.1)
    assert after[0].timestamp_s == pytest.approx(0.5, abs=0.1)
    assert after[0].params == 0
    _, ticks = decode_echo_response(client.ask(encode_echo_request(1))[1])
    assert ticks / TICKS_PER_S == pytest.approx(46.0, abs=0.01)


def test_after_a_restart_exposures_keep_their_rate(tracker: StillTracker) -> None:
    tracker.let_pass(1.0)
    tracker.server.restart()
    n = tracker.server.n_exposed
    tracker.let_pass(1.0)
    assert tracker.server.n_exposed - n == pytest.approx(100, abs=1)


def test_a_changed_version_is_spoken_at_once_and_said_in_one_frame(tracker: StillTracker, client: RawClient) -> None:
    tracker.let_pass(0.1)
    frames(client)
    tracker.server.change_version("3.1")
    tracker.let_pass(0.2)
    found = frames(client, (3, 1))
    assert [frame.params for frame in found].count(BITSTREAM_CHANGED) == 1
    info = decode_server_info(client.ask(encode_connect(ConnectRequest("test")))[1])
    assert (info.natnet_version, info.app_version) == ((3, 1, 0, 0), (2, 1, 0, 0))


def test_a_new_body_is_defined_said_in_one_frame_and_not_tracked(tracker: StillTracker, client: RawClient) -> None:
    tracker.let_pass(0.1)
    frames(client)
    tracker.server.add_body("wand")
    tracker.let_pass(0.2)
    found = frames(client)
    assert [frame.params for frame in found].count(MODELS_CHANGED) == 1
    assert found[-1].bodies["id"].tolist() == [4, 5]
    assert found[-1].bodies["params"].tolist() == [1, 0]
    models = decode_models(client.ask(encode_packet(Message.REQUEST_MODELDEF))[1], (4, 1))
    assert [(m.name, m.body_id) for m in models if isinstance(m, RigidBodyModel)] == [("clamp", 4), ("wand", 5)]


def test_frame_numbers_jump_on_command(tracker: StillTracker, client: RawClient) -> None:
    tracker.let_pass(0.2)
    tracker.server.jump(7)
    tracker.let_pass(0.2)
    steps = np.diff([frame.frame_number for frame in frames(client)])
    assert sorted(set(steps.tolist())) == [1, 8]
    assert np.count_nonzero(steps == 8) == 1


def test_frame_numbers_jump_by_chance_while_time_goes_on_evenly() -> None:
    with still_tracker(HOST, frame_jump_probability=0.3) as tracker:
        tracker.let_pass(5.0)
        numbers = sorted(tracker.scene.exposures)
        times = np.array([tracker.scene.host_ns[number] for number in numbers])
    steps = np.diff(numbers)
    assert set(steps.tolist()) == set(range(1, 12))
    assert np.mean(steps > 1) == pytest.approx(0.3, abs=0.08)
    assert np.ptp(np.diff(times)) < 1000


def test_a_ptp_time_is_sent_where_the_version_has_room_for_it() -> None:
    with still_tracker(HOST, ptp=True) as tracker, RawClient(tracker.server.address) as new:
        new.ask(encode_connect(ConnectRequest("new")))
        with RawClient(tracker.server.address) as old:
            old.ask(encode_connect(ConnectRequest("old", bitstream=(4, 0))))
            tracker.let_pass(0.1)
            (frame, *_), (plain, *_) = frames(new), frames(old, (4, 0))
        seconds, fraction = frame.ptp
        ns = seconds * 10**9 + fraction * 10**9 / 2**32
        assert ns == pytest.approx(tracker.scene.host_ns[frame.frame_number], abs=1)
    assert plain.ptp == (0, 0)


@pytest.fixture
def multicast() -> Iterator[StillTracker]:
    settings = {"natnet_multicast": True, "natnet_group": GROUP, "data_port": DATA_PORT, "natnet_version": "4.2"}
    with still_tracker(HOST, **settings) as still:
        yield still


@pytest.fixture
def member(multicast: StillTracker) -> Iterator[socket.socket]:
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    link.bind(("", DATA_PORT))
    link.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + socket.inet_aton(HOST))
    link.settimeout(20.0)
    yield link
    link.close()


def test_multicast_frames_come_from_the_data_port_and_need_no_client(
    multicast: StillTracker, member: socket.socket
) -> None:
    multicast.let_pass(15.0)
    assert multicast.server.n_sent >= 1400
    packet, sender = member.recvfrom(LARGEST_PACKET)
    assert sender == (HOST, DATA_PORT)
    assert decode_frame(split_packet(packet)[1], (4, 2)).frame_number == 1042


def test_in_multicast_no_client_chooses_the_version(multicast: StillTracker) -> None:
    with RawClient(multicast.server.address) as client:
        info = decode_server_info(client.ask(encode_connect(ConnectRequest("test", bitstream=(3, 0))))[1])
        assert info.is_multicast
        assert info.multicast_group == (239, 255, 42, 98)
        assert info.data_port == DATA_PORT
        assert decode_text(client.ask(encode_request("Bitstream"))[1]) == "Bitstream,4.2"
        assert client.ask(encode_request("Bitstream,4.1"))[1] == b"\1\0\0\0"
        multicast.let_pass(0.5)
        assert client.hears_nothing()


def test_a_broadcast_discovery_is_answered_by_the_tracker_itself(tracker: StillTracker) -> None:
    _, port = tracker.server.address
    with RawClient(("127.0.32.255", port)) as seeker:
        seeker.send(encode_connect(ConnectRequest("seeker"), Message.DISCOVERY))
        packet, sender = seeker.socket.recvfrom(LARGEST_PACKET)
    assert split_packet(packet)[0] == Message.SERVERINFO
    assert sender == tracker.server.address
