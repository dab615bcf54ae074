"""What a test hears of a tracker, and our client in front of a scripted one."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from natnet_scripted import ScriptedTracker

from bench.config import TrackerConfig
from bench.drivers.flight import FlightRecorder
from bench.drivers.tracker.natnet.client import NatNetTracker
from bench.errors import BenchError
from bench.model import DeviceInfo, LogEntry, Record, TrackerFrame
from bench.timing import RunClock

PATIENCE_S = 20.0


class Recorder:
    """A sink, and the callbacks."""

    def __init__(self) -> None:
        self.records: queue.Queue[Record] = queue.Queue()
        self.seen: list[Record] = []
        self.losses: queue.Queue[BenchError] = queue.Queue()
        self.missed: list[tuple[str, int]] = []

    def wait_for(self, is_it: Callable[[Record], bool]) -> Record:
        """Return the first record, old or new, that fits."""
        deadline = time.monotonic() + PATIENCE_S
        for record in self.seen:
            if is_it(record):
                return record
        while True:
            record = self.records.get(timeout=max(0.01, deadline - time.monotonic()))
            self.seen.append(record)
            if is_it(record):
                return record

    def wait_for_frame(self, number: int) -> TrackerFrame:
        found = self.wait_for(lambda record: isinstance(record, TrackerFrame) and record.frame_number == number)
        assert isinstance(found, TrackerFrame)
        return found

    def wait_for_log(self, words: str) -> LogEntry:
        found = self.wait_for(lambda record: isinstance(record, LogEntry) and words in record.text)
        assert isinstance(found, LogEntry)
        return found


def make_client(
    tracker: ScriptedTracker, recorder: Recorder, *, speed: float = 1.0, stem: Path | None = None, **keys: object
) -> NatNetTracker:
    clock = RunClock.start(speed)
    config = TrackerConfig(host=tracker.host, command_port=tracker.port, **keys)
    missed = recorder.missed
    return NatNetTracker(
        config,
        clock,
        on_missed=lambda topic, n: missed.append((topic, n)),
        on_lost=recorder.losses.put,
        flight=FlightRecorder("tracker", clock, stem),
    )


@contextmanager
def connected(tracker: ScriptedTracker, recorder: Recorder, **keys: object) -> Iterator[DeviceInfo]:
    client = make_client(tracker, recorder, **keys)
    info = client.open(recorder.records.put)
    try:
        yield info
    finally:
        client.close()
