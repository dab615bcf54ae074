"""Notes the computer's UTC clock beside the run's host time, so that a reader can tell when NTP or a hand moved it."""

from __future__ import annotations

import time
from collections.abc import Callable

from bench.model import ClockSample, ClockSource, Record
from bench.timing import Clock, patience_ns

__all__ = ["UtcWatch"]

PERIOD_S = 10.0
"""NTP slews by at most 500 ppm, which is 5 ms in this time: what differs by more was a step."""
NS_PER_S = 1e9


class UtcWatch:
    """Reads both clocks each 10 s of the machine's own time, driven by whoever has something to do anyway.

    Parameters
    ----------
    clock : Clock
        Host time of the run.
    record : callable
        Where the pairs go.
    read_utc_ns : callable, optional
        The computer's UTC clock.
    """

    def __init__(
        self, clock: Clock, record: Callable[[Record], None], read_utc_ns: Callable[[], int] = time.time_ns
    ) -> None:
        self._clock = clock
        self._record = record
        self._read_utc_ns = read_utc_ns
        self._period_ns = patience_ns(clock, PERIOD_S)
        self._next_ns = 0

    def update(self, now_ns: int) -> None:
        """Note a pair if one is due."""
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + self._period_ns
        send_ns = self._clock.now_ns()
        utc_ns = self._read_utc_ns()
        self._record(ClockSample(ClockSource.HOST, send_ns, utc_ns, self._clock.now_ns(), NS_PER_S))
