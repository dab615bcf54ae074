"""The client against a tracker whose packets the test chooses, over loopback."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from natnet_recorder import PATIENCE_S, Recorder, connected, make_client
from natnet_recording import stored
from natnet_scripted import ScriptedTracker, make_packet, scripted_tracker

from bench.config import TrackerConfig
from bench.drivers.receive import KERNEL, KERNEL_STAMPS, PROGRAM, StampedSocket
from bench.drivers.tracker import make_tracker
from bench.drivers.tracker.natnet import handshake
from bench.drivers.tracker.natnet import link as link_module
from bench.drivers.tracker.natnet.messages import ServerInfo, encode_number_response
from bench.drivers.tracker.natnet.wire import Message, encode_packet
from bench.errors import ConnectError, DeviceStateError, LinkLostError, ProtocolError
from bench.model import Record, Severity, TrackerFrame
from bench.timing import RunClock


@pytest.fixture
def tracker() -> Iterator[ScriptedTracker]:
    with scripted_tracker() as scripted:
        yield scripted


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def short_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handshake, "CONNECT_WAIT_S", 0.05)
    monkeypatch.setattr(handshake, "QUESTION_WAIT_S", 0.05)


def test_the_client_learns_what_the_tracker_is(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with connected(tracker, recorder) as info:
        assert (info.device, info.kind, info.address) == ("tracker", "natnet", f"{tracker.host}:{tracker.port}")
        assert info.version == "Motive 3.1, NatNet 4.1"
        assert info.rate_hz == 100.0
        assert info.bodies == {1: "clamp"}
        assert info.detail["clock_hz"] == "1000000"
        assert info.detail["bitstream"] == "4.1"
        assert info.detail["up_axis"] == "y"
        assert info.detail["stamped_by"] == (KERNEL if KERNEL_STAMPS else PROGRAM)


def test_the_client_stamps_by_itself_where_the_kernel_does_not(
    tracker: ScriptedTracker, recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_module, "StampedSocket", partial(StampedSocket, option=None))
    with connected(tracker, recorder) as info:
        assert info.detail["stamped_by"] == PROGRAM
        tracker.send(make_packet(1))
        assert recorder.wait_for_frame(1).arrival_ns > 0


def test_frames_arrive_with_points_ids_and_bodies(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with connected(tracker, recorder):
        tracker.send(make_packet(100))
        frame = recorder.wait_for_frame(100)
        assert frame.points_m[:, 0].tolist() == [100.0, 100.0]
        assert frame.ids.tolist() == [65537, 50001]
        assert [body.body_id for body in frame.bodies] == [1]


def test_gaps_and_garbage_are_counted_and_frames_go_on(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with connected(tracker, recorder):
        for packet in (make_packet(100), b"\xff" * 30, b"x", make_packet(101)[:50], make_packet(105)):
            tracker.send(packet)
        recorder.wait_for_frame(105)
        recorder.wait_for_log("cannot be read")
    assert recorder.missed == [("/tracker/points", 4)]
    assert recorder.losses.empty()


def test_a_packet_that_cannot_be_read_is_kept_in_a_file_that_the_log_names(
    tracker: ScriptedTracker, recorder: Recorder, tmp_path: Path
) -> None:
    damaged = make_packet(100)[:-9]
    with connected(tracker, recorder, stem=tmp_path / "run-1"):
        tracker.send(damaged)
        told = recorder.wait_for_log("cannot be read")
        tracker.send(damaged)
        tracker.send(make_packet(101))
        recorder.wait_for_frame(101)
    path = tmp_path / "run-1.tracker-packets-1.txt"
    assert list(tmp_path.iterdir()) == [path]
    assert told.text.endswith(f"packets of the link are in {path}.")
    assert path.read_text(encoding="utf-8").splitlines()[-1].endswith(f" < {damaged.hex()}")


def test_a_tracker_that_falls_silent_leaves_its_last_packets(
    tracker: ScriptedTracker, recorder: Recorder, tmp_path: Path
) -> None:
    with connected(tracker, recorder, stem=tmp_path / "run-1"):
        tracker.send(make_packet(100))
        recorder.wait_for_frame(100)
        tracker.send(encode_packet(Message.DISCONNECT))
        error = recorder.losses.get(timeout=PATIENCE_S)
    (path,) = tmp_path.iterdir()
    assert f"packets of the link are in {path}." in str(error)
    assert f" < {make_packet(100).hex()}\n" in path.read_text(encoding="utf-8")


def test_packets_of_strangers_are_ignored(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with connected(tracker, recorder), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.32.77", 0))
        assert tracker.client is not None
        stranger.sendto(make_packet(5000), tracker.client)
        tracker.send(make_packet(100))
        recorder.wait_for_frame(100)
    assert not any(isinstance(r, TrackerFrame) and r.frame_number == 5000 for r in recorder.seen)
    assert recorder.missed == []


def test_the_client_keeps_itself_alive_asks_the_clock_and_takes_its_leave(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    with connected(tracker, recorder):
        tracker.send(make_packet(100))
        recorder.wait_for_frame(100)
        recorder.wait_for(lambda record: type(record).__name__ == "ClockSample")
    deadline = time.monotonic() + PATIENCE_S
    while Message.DISCONNECT not in tracker.heard and time.monotonic() < deadline:
        time.sleep(0.01)
    assert {Message.KEEPALIVE, Message.ECHOREQUEST, Message.DISCONNECT} <= set(tracker.heard)
    assert tracker.heard[0] == Message.CONNECT


def test_a_silent_tracker_is_lost_once_and_its_return_is_told(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with connected(tracker, recorder):
        tracker.send(make_packet(100))
        error = recorder.losses.get(timeout=PATIENCE_S)
        assert isinstance(error, LinkLostError)
        assert f"{tracker.host}:{tracker.port} has sent no frame for 1 s, though it answers." in str(error)
        assert recorder.wait_for_log("no frame").severity is Severity.ERROR
        tracker.send(make_packet(101))
        recorder.wait_for_log("again")
    assert recorder.losses.empty()


def test_a_tracker_that_takes_its_leave_is_lost_at_once(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with connected(tracker, recorder):
        tracker.send(encode_packet(Message.DISCONNECT))
        assert "ended the connection" in str(recorder.losses.get(timeout=PATIENCE_S))


def test_an_error_of_the_sink_is_not_swallowed(tracker: ScriptedTracker, recorder: Recorder) -> None:
    def fail(record: Record) -> None:
        if isinstance(record, TrackerFrame):
            raise ZeroDivisionError

    client = make_client(tracker, recorder)
    client.open(fail)
    try:
        tracker.send(make_packet(100))
        assert "ZeroDivisionError" in str(recorder.losses.get(timeout=PATIENCE_S))
    finally:
        client.close()


def test_the_client_may_be_closed_twice_before_it_was_opened_and_from_its_own_thread(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    client = make_client(tracker, recorder)
    client.close()
    client = make_client(tracker, recorder)

    def close_it(record: Record) -> None:
        if isinstance(record, TrackerFrame):
            client.close()
            recorder.records.put(record)

    client.open(close_it)
    tracker.send(make_packet(100))
    recorder.wait_for_frame(100)
    client.close()
    client.close()


@pytest.mark.usefixtures("short_patience")
def test_an_unreachable_host_is_named_with_what_to_look_at(recorder: Recorder) -> None:
    client = make_tracker(TrackerConfig(host="127.0.32.99", command_port=1599), RunClock.start())
    with pytest.raises(ConnectError, match=r"127\.0\.32\.99:1599 does not answer.*Motive.*firewall.*1599"):
        client.open(recorder.records.put)
    client.close()


def test_a_host_without_address_is_named(recorder: Recorder) -> None:
    client = make_tracker(TrackerConfig(host="no such host.invalid"), RunClock.start())
    with pytest.raises(ConnectError, match="no such host"):
        client.open(recorder.records.put)


def test_a_foreign_local_address_is_named(tracker: ScriptedTracker, recorder: Recorder) -> None:
    client = make_client(tracker, recorder, local_address="192.0.2.1")
    with pytest.raises(ConnectError, match=r"192\.0\.2\.1.*local_address"):
        client.open(recorder.records.put)


def test_the_own_address_can_be_chosen(tracker: ScriptedTracker, recorder: Recorder) -> None:
    client = make_client(tracker, recorder, local_address="127.0.32.5")
    info = client.open(recorder.records.put)
    client.close()
    assert info.detail["local_address"] == "127.0.32.5"
    assert tracker.client is not None
    assert tracker.client[0] == "127.0.32.5"


@pytest.mark.parametrize("version", [(2, 8, 0, 0), (1, 0, 0, 0)])
def test_a_tracker_of_the_oldest_kind_is_refused(
    tracker: ScriptedTracker, recorder: Recorder, version: tuple[int, ...]
) -> None:
    tracker.info = ServerInfo("Motive", (1, 10, 0, 0), version, 0)
    with pytest.raises(ProtocolError, match=r"2\.9 is the oldest"):
        make_client(tracker, recorder).open(recorder.records.put)


def test_positions_in_another_unit_are_refused(tracker: ScriptedTracker, recorder: Recorder) -> None:
    tracker.answers["UnitsToMillimeters"] = encode_number_response(1.0)
    with pytest.raises(DeviceStateError, match="1 mm, not in metres"):
        make_client(tracker, recorder).open(recorder.records.put)


def test_an_answer_of_the_wrong_size_is_a_protocol_error(tracker: ScriptedTracker, recorder: Recorder) -> None:
    tracker.answers["FrameRate"] = encode_packet(Message.RESPONSE, b"what?")
    with pytest.raises(ProtocolError, match="5 bytes"):
        make_client(tracker, recorder).open(recorder.records.put)


@pytest.mark.usefixtures("short_patience")
def test_a_tracker_that_knows_no_requests_and_no_models_is_taken_as_it_is(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    tracker.answers = {}
    tracker.models = None
    with connected(tracker, recorder) as info:
        assert info.rate_hz != info.rate_hz
        assert info.bodies == {}
        recorder.wait_for_log("no model definitions")


def test_unreadable_models_are_told_and_frames_are_read(tracker: ScriptedTracker, recorder: Recorder) -> None:
    tracker.models = encode_packet(Message.MODELDEF, struct.pack("<iii", 1, 1, 999))
    with connected(tracker, recorder):
        recorder.wait_for_log("cannot be read")
        tracker.send(make_packet(100))
        recorder.wait_for_frame(100)


def test_a_real_motive_21_is_understood(tracker: ScriptedTracker, recorder: Recorder) -> None:
    tracker.info = ServerInfo("Motive", (2, 1, 0, 0), (3, 0, 0, 0), 3_312_787)
    tracker.models = stored("modeldef_packet_v3")
    with connected(tracker, recorder) as info:
        assert info.bodies == {2: "RaceQuad"}
        assert info.detail["bitstream"] == "3.0"
        tracker.send(stored("mocapframe_packet_v3"))
        assert recorder.wait_for_frame(162_734).ids.tolist()[-1] == 50007
