from __future__ import annotations

import threading

import pytest
from natnet_bench import PATIENCE_S, running_tracker

from bench.config import TrackerConfig
from bench.drivers.tracker import make_tracker
from bench.model import TrackerFrame

HOST = "127.0.61.31"


@pytest.fixture
def tracker():
    with running_tracker(HOST) as running:
        yield running


class Reports:
    """What our driver says of the tracker."""

    def __init__(self, tracker):
        self.frames, self.missed, self.lost = [], [], []
        self._changed = threading.Condition()
        host, port = tracker.server.address
        self.client = make_tracker(
            TrackerConfig(host=host, command_port=port),
            tracker.clock,
            on_missed=lambda _topic, n: self._note(self.missed, n),
            on_lost=lambda error: self._note(self.lost, str(error)),
        )
        self.client.open(lambda record: self._note(self.frames, record) if isinstance(record, TrackerFrame) else None)

    def _note(self, notes, note):
        with self._changed:
            notes.append(note)
            self._changed.notify_all()

    def wait(self, condition):
        with self._changed:
            assert self._changed.wait_for(condition, PATIENCE_S)


@pytest.fixture
def reports(tracker):
    made = Reports(tracker)
    yield made
    made.client.close()


def test_a_short_stall_of_the_tracker_is_a_gap_that_is_counted(tracker, reports):
    reports.wait(lambda: len(reports.frames) > 5)
    tracker.server.stall(0.2)
    reports.wait(lambda: sum(reports.missed) >= 15)
    numbers = [frame.frame_number for frame in reports.frames]
    assert sum(reports.missed) == numbers[-1] - numbers[0] + 1 - len(numbers)
    assert not reports.lost


def test_a_long_stall_of_the_tracker_is_a_lost_link(tracker, reports):
    reports.wait(lambda: len(reports.frames) > 5)
    tracker.server.stall(3.0)
    reports.wait(lambda: reports.lost)
    assert "has sent no frame for 1 s" in reports.lost[0]
