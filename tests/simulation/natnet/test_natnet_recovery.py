"""Our client and a simulated tracker that restarts, changes, or streams to everyone."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from natnet_bench import PATIENCE_S, TICKS_PER_S, SimulatedTracker, running_tracker

from bench.config import TrackerConfig
from bench.drivers.tracker import make_tracker
from bench.drivers.tracker.natnet import client as client_module
from bench.drivers.tracker.natnet.bitstream import DOUBTFUL_FAILURES
from bench.model import ClockSample, LogEntry, Record, Severity, StampKind, TrackerFrame
from bench.timing import estimate_echo_map

HOST = "127.0.32.61"
SPEED = 10.0
DATA_PORT = 15_113


@pytest.fixture(autouse=True)
def short_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "SILENCE_S", 0.2)
    monkeypatch.setattr(client_module, "RECONNECT_S", 0.05)


class Heard:
    """Everything that our client pushed."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        self.missed = 0
        self._changed = threading.Condition()

    def put(self, record: Record) -> None:
        with self._changed:
            self.records.append(record)
            self._changed.notify_all()

    def miss(self, _topic: str, n: int) -> None:
        self.missed += n

    def wait(self, is_enough: Callable[[], bool]) -> None:
        with self._changed:
            assert self._changed.wait_for(is_enough, PATIENCE_S)

    def frames(self, segment: int | None = None) -> list[TrackerFrame]:
        found = [record for record in self.records if isinstance(record, TrackerFrame)]
        return [frame for frame in found if segment in (None, frame.segment)]

    def log(self) -> list[str]:
        return [record.text for record in self.records if isinstance(record, LogEntry)]


@contextmanager
def listening(tracker: SimulatedTracker, **keys: object) -> Iterator[Heard]:
    heard = Heard()
    host, port = tracker.server.address
    client = make_tracker(TrackerConfig(host=host, command_port=port, **keys), tracker.clock, on_missed=heard.miss)
    client.open(heard.put)
    try:
        yield heard
    finally:
        client.close()


def test_a_restarted_tracker_is_met_again_with_its_new_clock() -> None:
    with running_tracker(HOST, SPEED) as tracker, listening(tracker) as heard:
        heard.wait(lambda: len(heard.frames()) >= 100)
        tracker.server.act(tracker.server.restart)
        heard.wait(lambda: len(heard.frames(1)) >= 300)
        clock = tracker.server._tracker_clock
    assert heard.missed == 0
    assert {frame.segment for frame in heard.frames()} == {0, 1}
    assert all(frame.device_ticks < 1e12 for frame in heard.frames(1))
    assert sum("clock segment 1 begins" in text for text in heard.log()) == 1
    samples = [record for record in heard.records if isinstance(record, ClockSample) and record.segment == 1]
    send_ns, ticks, receive_ns = np.array([(s.send_ns, s.device_ticks, s.receive_ns) for s in samples]).T
    found = estimate_echo_map(send_ns, ticks, receive_ns, 1e9 / TICKS_PER_S)
    middle = int(ticks[len(ticks) // 2])
    assert abs(found.to_host_ns(middle) - clock.host_ns_at(middle)) <= (receive_ns - send_ns).max()


def test_a_tracker_that_changes_its_version_while_it_streams_is_read_on_and_each_frame_accounted_for() -> None:
    with running_tracker(HOST, SPEED) as tracker, listening(tracker) as heard:
        for version in ("3.1", "4.0", "4.1"):
            seen = len(heard.frames())
            heard.wait(lambda seen=seen: len(heard.frames()) >= seen + 50)
            tracker.server.act(lambda version=version: tracker.server.change_version(version))
        seen = len(heard.frames())
        heard.wait(lambda: len(heard.frames()) >= seen + 50)
    numbers = [frame.frame_number for frame in heard.frames()]
    for frame in heard.frames():
        assert np.array_equal(frame.points_m, tracker.scene.exposures[frame.frame_number].points_m)
    # frames that were on their way when the version changed do not say that it did
    assert heard.missed == numbers[-1] - numbers[0] + 1 - len(numbers) <= 2 * (DOUBTFUL_FAILURES - 1)
    assert sum("The tracker's frames are of NatNet" in text for text in heard.log()) == 2


def test_a_new_rigid_body_is_named_in_the_recording() -> None:
    with running_tracker(HOST, SPEED) as tracker, listening(tracker) as heard:
        heard.wait(lambda: len(heard.frames()) >= 10)
        tracker.server.act(lambda: tracker.server.add_body("flange"))
        heard.wait(lambda: any("rigid bodies are now: clamp (4), flange (5)" in text for text in heard.log()))


@pytest.mark.parametrize("version", ["3.0", "3.1", "4.0", "4.1", "4.2", "4.3"])
def test_every_version_is_received_by_multicast_without_a_word_in_the_configuration(version: str) -> None:
    options = {"natnet_version": version, "natnet_multicast": True, "data_port": DATA_PORT}
    with running_tracker(HOST, SPEED, **options) as tracker, listening(tracker) as heard:
        heard.wait(lambda: len(heard.frames()) >= 50)
        heard.wait(lambda: any(isinstance(record, ClockSample) for record in heard.records))
    numbers = [frame.frame_number for frame in heard.frames()]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    for frame in heard.frames():
        shown = tracker.scene.exposures[frame.frame_number]
        assert np.array_equal(frame.points_m, shown.points_m)
        assert np.array_equal(frame.ids, shown.ids)
        assert frame.stamp is StampKind.MID_EXPOSURE
    assert heard.missed == 0
    assert not [r for r in heard.records if isinstance(r, LogEntry) and r.severity is not Severity.INFO]


def test_a_multicast_that_stalls_goes_on_and_the_frames_that_never_came_are_counted() -> None:
    options = {"natnet_multicast": True, "data_port": DATA_PORT}
    with running_tracker(HOST, SPEED, **options) as tracker, listening(tracker) as heard:
        heard.wait(lambda: len(heard.frames()) >= 50)
        tracker.server.stall(0.5)
        heard.wait(lambda: any("sends frames again" in text for text in heard.log()))
        seen = len(heard.frames())
        heard.wait(lambda: len(heard.frames()) >= seen + 10)
    numbers = [frame.frame_number for frame in heard.frames()]
    assert heard.missed == numbers[-1] - numbers[0] + 1 - len(numbers) > 0
    assert {frame.segment for frame in heard.frames()} == {0}


def test_the_time_of_a_ptp_clock_is_recorded() -> None:
    with running_tracker(HOST, SPEED, ptp=True) as tracker, listening(tracker) as heard:
        heard.wait(lambda: len(heard.frames()) >= 10)
    for frame in heard.frames():
        assert frame.ptp_seconds == tracker.scene.host_ns[frame.frame_number] // 1_000_000_000
