"""Multicasts over loopback, and calls for trackers."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
from natnet_recorder import Recorder, connected, make_client
from natnet_scripted import ScriptedTracker, make_packet, scripted_tracker

from bench.config import TrackerConfig
from bench.drivers.flight import FlightRecorder
from bench.drivers.tracker.natnet import handshake, networks
from bench.drivers.tracker.natnet.link import CommandLink
from bench.drivers.tracker.natnet.networks import find_trackers, open_group_socket
from bench.errors import ConnectError, DeviceStateError
from bench.model import LogEntry, TrackerFrame
from bench.timing import RunClock


@pytest.fixture(autouse=True)
def short_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(networks, "CALL_S", 0.1)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port: int = probe.getsockname()[1]
        return port


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def tracker() -> Iterator[ScriptedTracker]:
    with scripted_tracker() as scripted:
        scripted.info = replace(scripted.info, is_multicast=True, data_port=free_port())
        yield scripted


def hear_one(tracker: ScriptedTracker, recorder: Recorder, **keys: object) -> str:
    """Connect, receive one frame by multicast, and return how the client says that it is connected."""
    with connected(tracker, recorder, **keys) as info:
        tracker.send_to_group(make_packet(100))
        recorder.wait_for_frame(100)
    return info.detail["connection"]


def test_a_tracker_that_streams_multicast_is_followed_without_a_word_in_the_configuration(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    port = tracker.info.data_port
    assert hear_one(tracker, recorder) == f"multicast 239.255.42.99:{port}"


def test_group_and_port_may_be_chosen(tracker: ScriptedTracker, recorder: Recorder) -> None:
    chosen = tracker.info.data_port
    keys = {"connection": "multicast", "multicast_group": "239.1.2.3", "data_port": chosen}
    told, tracker.info = tracker.info, replace(tracker.info, multicast_group=(239, 1, 2, 3))
    tracker.told = replace(told, data_port=9)
    assert hear_one(tracker, recorder, **keys) == f"multicast 239.1.2.3:{chosen}"


def test_in_a_multicast_the_clock_is_asked_on_the_command_port(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with connected(tracker, recorder):
        tracker.send_to_group(make_packet(100))
        recorder.wait_for_frame(100)
        recorder.wait_for(lambda record: type(record).__name__ == "ClockSample")


def test_a_multicast_is_of_the_trackers_own_version(tracker: ScriptedTracker, recorder: Recorder) -> None:
    tracker.info = replace(tracker.info, natnet_version=(4, 3, 0, 0))
    with connected(tracker, recorder) as info:
        assert info.detail["bitstream"] == "4.3"
        assert info.detail["version_chosen_by"] == "server"


def test_a_multicast_of_another_tracker_on_the_same_group_is_ignored(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    with connected(tracker, recorder), scripted_tracker("127.0.32.3") as other:
        other.info = tracker.info
        other.send_to_group(make_packet(5000))
        tracker.send_to_group(make_packet(100))
        recorder.wait_for_frame(100)
    assert [r.frame_number for r in recorder.seen if isinstance(r, TrackerFrame)] == [100]


def test_two_programs_may_follow_the_same_multicast(tracker: ScriptedTracker, recorder: Recorder) -> None:
    other = Recorder()
    with connected(tracker, recorder), connected(tracker, other, local_address="127.0.0.1"):
        tracker.send_to_group(make_packet(100))
        recorder.wait_for_frame(100)
        other.wait_for_frame(100)


@pytest.mark.parametrize(("asked", "is_multicast"), [("unicast", True), ("multicast", False)])
def test_a_tracker_that_streams_in_another_way_than_was_asked_for_is_refused(
    tracker: ScriptedTracker, recorder: Recorder, asked: str, is_multicast: bool
) -> None:
    tracker.info = replace(tracker.info, is_multicast=is_multicast)
    client = make_client(tracker, recorder, connection=asked)
    with pytest.raises(DeviceStateError, match=rf"streams \w+cast, and \[tracker\] connection asks for {asked}") as bad:
        client.open(recorder.records.put)
    assert f"Transmission Type to {asked.capitalize()}" in bad.value.hint


def test_a_multicast_whose_port_another_program_keeps_to_itself_is_refused(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as keeper:
        keeper.bind(("", tracker.info.data_port))
        client = make_client(tracker, recorder)
        with pytest.raises(ConnectError, match="cannot be received") as bad:
            client.open(recorder.records.put)
    assert "Another program holds UDP port" in bad.value.hint


def test_a_multicast_on_an_address_that_is_not_ours_is_refused() -> None:
    with pytest.raises(ConnectError, match=r"cannot be received at 192\.0\.2\.1") as bad:
        open_group_socket("239.255.42.99", free_port(), "192.0.2.1")
    assert "local_address" in bad.value.hint


def test_a_link_that_is_closed_follows_nothing() -> None:
    clock = RunClock.start()
    link = CommandLink(TrackerConfig(host="127.0.32.2"), clock, FlightRecorder("tracker", clock))
    link.follow("239.255.42.99", 1511)
    assert link.group == ""


@pytest.mark.parametrize("group", ["192.168.0.1", "everyone"])
def test_a_group_that_is_none_is_refused_by_the_configuration(group: str) -> None:
    with pytest.raises(ValueError, match=r"no multicast group: those are 224\.0\.0\.0"):
        TrackerConfig(host="h", multicast_group=group)


def test_a_group_without_a_multicast_is_refused_by_the_configuration() -> None:
    with pytest.raises(ValueError, match="data_port belongs to a multicast"):
        TrackerConfig(host="h", connection="unicast", data_port=1511)


@contextmanager
def tracker_for_all() -> Iterator[ScriptedTracker]:
    """Serve on all addresses of this machine: a call for everyone reaches no socket that is bound to one."""
    with scripted_tracker("") as scripted:
        yield scripted


def test_trackers_answer_a_call_on_the_networks_of_this_machine() -> None:
    with tracker_for_all() as scripted:
        assert find_trackers(scripted.port, "127.0.0.1") == {"127.0.0.1": "Motive 3.1"}
        assert find_trackers(scripted.port, "127.0.32.5") == {"127.0.0.1": "Motive 3.1"}
        assert find_trackers(scripted.port, "192.0.2.1") == {}


def test_this_computer_is_one_of_the_networks() -> None:
    assert ("127.0.0.1", "127.255.255.255") in networks._networks()


def test_a_call_that_nobody_answers_finds_nobody() -> None:
    assert find_trackers(free_port(), "127.0.0.1") == {}


def test_garbage_in_answer_to_a_call_is_passed_over() -> None:
    with tracker_for_all() as scripted:
        answer = scripted.reply
        scripted.reply = lambda message, payload: (answer(message, payload) or b"")[:50]
        assert find_trackers(scripted.port, "127.0.0.1") == {}


def test_when_the_tracker_does_not_answer_those_that_do_are_named(
    recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(handshake, "CONNECT_WAIT_S", 0.02)
    with tracker_for_all() as scripted:
        scripted.host = "192.0.2.77"
        client = make_client(scripted, recorder, local_address="127.0.0.1")
        with pytest.raises(ConnectError, match=r"192\.0\.2\.77:\d+ does not answer") as bad:
            client.open(recorder.records.put)
    assert "these trackers answer: 127.0.0.1 (Motive 3.1)" in bad.value.hint


def test_nothing_is_worth_a_word(tracker: ScriptedTracker, recorder: Recorder) -> None:
    hear_one(tracker, recorder)
    assert not [r for r in recorder.seen if isinstance(r, LogEntry)]
