"""Troubles that repeat: told at once, then at most once a second, always with the count."""

from __future__ import annotations

from bench.drivers.base import RecordSink
from bench.model import LogEntry, Severity
from bench.timing import Clock, patience_ns

__all__ = ["Complaint"]

PAUSE_S = 1.0
"""Machine time between two entries, so that a bad link does not fill the run file with words."""


class Complaint:
    """Counts one kind of trouble of the tracker's stream and tells it to the run's log."""

    def __init__(self, what: str, severity: Severity, clock: Clock, sink: RecordSink) -> None:
        self._what = what
        self._severity = severity
        self._clock = clock
        self._sink = sink
        self._untold = 0
        self._detail = ""
        self._next_ns = 0
        self.total = 0

    def add(self, detail: str, n: int = 1) -> None:
        """Count `n` more."""
        self._untold += n
        self.total += n
        self._detail = detail
        self.tell()

    def tell(self, *, at_once: bool = False) -> None:
        """Write what was not told yet, unless the last entry is too recent."""
        if self._untold == 0:
            return
        now_ns = self._clock.now_ns()
        if now_ns < self._next_ns and not at_once:
            return
        text = f"{self._what}: {self._untold}, {self.total} since the start. {self._detail}"
        self._untold = 0
        self._next_ns = now_ns + patience_ns(self._clock, PAUSE_S)
        self._sink(LogEntry(now_ns, self._severity, "tracker", text))
