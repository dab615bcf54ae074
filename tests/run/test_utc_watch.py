"""The computer's UTC clock is noted beside host time, and a step of it is told."""

from __future__ import annotations

from bench.model import ClockSample, ClockSource, Record
from bench.run.utc_watch import UtcWatch
from bench.timing import ManualClock


def test_a_pair_is_noted_at_once_and_then_each_ten_seconds() -> None:
    clock, records = ManualClock(), list[Record]()
    watch = UtcWatch(clock, records.append, lambda: clock.now_ns() + 7)
    for _ in range(30 * 500):
        watch.update(clock.now_ns())
        clock.advance_ns(2_000_000)
    assert len(records) == 3
    for record in records:
        assert isinstance(record, ClockSample)
        assert record.source is ClockSource.HOST
        assert record.device_ticks == record.receive_ns + 7
