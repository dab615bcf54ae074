"""A tracker that falls silent, restarts or changes, over loopback."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
from natnet_recorder import PATIENCE_S, Recorder, connected
from natnet_scripted import CLOCK_HZ, ScriptedTracker, make_packet, scripted_tracker

from bench.drivers.tracker.natnet import client
from bench.drivers.tracker.natnet.messages import ServerInfo, encode_echo_response
from bench.drivers.tracker.natnet.wire import Message, encode_packet
from bench.errors import LinkLostError, ProtocolError
from bench.model import ClockSample, LogEntry, Severity, StampKind, TrackerFrame


@pytest.fixture(autouse=True)
def short_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "SILENCE_S", 0.2)
    monkeypatch.setattr(client, "RECONNECT_S", 0.05)


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def tracker() -> Iterator[ScriptedTracker]:
    with scripted_tracker() as scripted:
        yield scripted


def wait_for_connects(tracker: ScriptedTracker, n: int) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while tracker.heard.count(Message.CONNECT) < n and time.monotonic() < deadline:
        time.sleep(0.01)
    assert tracker.heard.count(Message.CONNECT) >= n


@contextmanager
def lost(tracker: ScriptedTracker, recorder: Recorder) -> Iterator[None]:
    """Receive frame 100, and lose the tracker."""
    with connected(tracker, recorder):
        tracker.send(make_packet(100))
        recorder.wait_for_frame(100)
        tracker.is_deaf = True
        assert isinstance(recorder.losses.get(timeout=PATIENCE_S), LinkLostError)
        yield


def come_back(tracker: ScriptedTracker) -> None:
    heard = tracker.heard.count(Message.CONNECT)
    tracker.is_deaf = False
    wait_for_connects(tracker, heard + 2)


def frames(recorder: Recorder) -> list[tuple[int, int]]:
    found = [record for record in recorder.seen if isinstance(record, TrackerFrame)]
    return [(frame.frame_number, frame.segment) for frame in found]


def warnings(recorder: Recorder) -> list[str]:
    found = [record for record in recorder.seen if isinstance(record, LogEntry)]
    return [entry.text for entry in found if entry.severity is Severity.WARN]


def test_a_tracker_that_falls_silent_is_asked_to_connect_again(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with lost(tracker, recorder):
        wait_for_connects(tracker, 3)


def test_a_tracker_whose_cable_was_pulled_goes_on_and_what_is_missing_is_counted(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    with lost(tracker, recorder):
        come_back(tracker)
        tracker.send(make_packet(150))
        recorder.wait_for_frame(150)
        recorder.wait_for_log("sends frames again")
    assert frames(recorder) == [(100, 0), (150, 0)]
    assert recorder.missed == [("/tracker/points", 49)]


def test_a_tracker_that_was_restarted_begins_a_clock_segment(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with lost(tracker, recorder):
        come_back(tracker)
        tracker.send(make_packet(3))
        recorder.wait_for_frame(3)
        tracker.send(make_packet(4))
        recorder.wait_for_frame(4)
    assert frames(recorder) == [(100, 0), (3, 1), (4, 1)]
    assert recorder.missed == []
    assert any("counts its frames anew, from 3: clock segment 1 begins" in text for text in warnings(recorder))


def test_a_tracker_whose_clock_was_restarted_begins_a_segment_though_its_numbers_go_on(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    tracker.echo = lambda asked: encode_echo_response(asked, 1_000_000)
    with connected(tracker, recorder):
        recorder.wait_for(lambda record: isinstance(record, ClockSample))
        tracker.send(make_packet(100))
        recorder.wait_for_frame(100)
        tracker.is_deaf = True
        recorder.losses.get(timeout=PATIENCE_S)
        tracker.echo = lambda asked: encode_echo_response(asked, 3_600 * CLOCK_HZ)
        come_back(tracker)
        tracker.send(make_packet(150, ticks=3_600 * CLOCK_HZ))
        recorder.wait_for_frame(150)
    assert frames(recorder) == [(100, 0), (150, 1)]
    assert recorder.missed == []
    assert any("clock was restarted" in text for text in warnings(recorder))


def test_a_tracker_of_another_version_is_read_in_that_version(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with lost(tracker, recorder):
        tracker.info = ServerInfo("Motive", (2, 1, 0, 0), (3, 1, 0, 0), 3_312_787)
        come_back(tracker)
        tracker.send(make_packet(200, version=(3, 1)))
        recorder.wait_for_frame(200)
        sample = recorder.wait_for(lambda r: isinstance(r, ClockSample) and r.ticks_per_s == 3_312_787.0)
    assert frames(recorder) == [(100, 0), (200, 1)]
    assert recorder.missed == []
    assert isinstance(sample, ClockSample)
    assert sample.segment == 1
    assert any("is Motive 2.1, NatNet 3.1 now; it was Motive 3.1, NatNet 4.1" in text for text in warnings(recorder))


def test_a_tracker_that_comes_back_with_a_version_that_nobody_reads_is_told_and_stays_lost(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    with lost(tracker, recorder):
        tracker.info = replace(tracker.info, natnet_version=(2, 0, 0, 0))
        come_back(tracker)
        assert recorder.wait_for_log("2.9 is the oldest").severity is Severity.ERROR
        come_back(tracker)
        tracker.send(make_packet(150))
        recorder.wait_for_frame(150)
    assert sum("2.9 is the oldest" in r.text for r in recorder.seen if isinstance(r, LogEntry)) == 1


def test_a_tracker_that_took_its_leave_and_came_back_sends_again(tracker: ScriptedTracker, recorder: Recorder) -> None:
    with connected(tracker, recorder):
        tracker.send(make_packet(100))
        recorder.wait_for_frame(100)
        tracker.send(encode_packet(Message.DISCONNECT))
        assert "ended the connection" in str(recorder.losses.get(timeout=PATIENCE_S))
        wait_for_connects(tracker, 2)
        tracker.send(make_packet(101))
        recorder.wait_for_frame(101)
        recorder.wait_for_log("sends frames again")
        recorder.wait_for_log("rigid bodies are now: clamp (1)")


def test_a_tracker_that_says_who_it_is_without_being_asked_changes_nothing(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    with connected(tracker, recorder):
        tracker.send(make_packet(100))
        recorder.wait_for_frame(100)
        assert tracker.client is not None
        tracker.send(tracker.reply(Message.CONNECT, b"") or b"")
        tracker.send(make_packet(101))
        recorder.wait_for_frame(101)
    assert frames(recorder) == [(100, 0), (101, 0)]
    assert warnings(recorder) == []


def test_a_tracker_of_natnet_2_is_recorded_by_its_softwares_time_and_never_asked_for_its_clock(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    tracker.info = ServerInfo("Motive", (1, 10, 0, 0), (2, 10, 0, 0))
    with connected(tracker, recorder, connection="unicast") as info:
        assert (info.detail["bitstream"], info.detail["connection"]) == ("2.10", "unicast")
        tracker.send(make_packet(100, version=(2, 10)))
        frame = recorder.wait_for_frame(100)
    assert (frame.stamp, frame.device_ticks) == (StampKind.TRACKER_TIME, 1_000_000_000)
    assert frame.capture_ns == pytest.approx(frame.arrival_ns, abs=1_000)
    assert Message.ECHOREQUEST not in tracker.heard


def test_a_tracker_of_natnet_2_that_does_not_tell_how_it_streams_is_heard_both_ways(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    tracker.info = ServerInfo("Motive", (1, 10, 0, 0), (2, 10, 0, 0), 0, 15_111)
    with connected(tracker, recorder, data_port=15_111) as info:
        assert info.detail["connection"] == "multicast 239.255.42.99:15111"
        tracker.send_to_group(make_packet(100, version=(2, 10)))
        tracker.send(make_packet(101, version=(2, 10)))
        recorder.wait_for_frame(100)
        recorder.wait_for_frame(101)


def test_a_tracker_of_natnet_3_that_does_not_tell_its_clocks_frequency_is_refused(
    tracker: ScriptedTracker, recorder: Recorder
) -> None:
    tracker.info = replace(tracker.info, clock_hz=0)
    with pytest.raises(ProtocolError, match="frequency of its clock"), connected(tracker, recorder):
        pass
