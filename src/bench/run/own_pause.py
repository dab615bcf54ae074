"""Notices that bench itself stood still: nothing that was not heard then can be held against a device."""

from __future__ import annotations

from collections.abc import Callable

from bench.model import LogEntry, Record, Severity
from bench.timing import Clock, patience_ns

__all__ = ["OwnPause"]

LONGEST_TURN_S = 1.0
"""The engine looks around every 0.25 s at the latest; busy machines were 0.4 s late, so 1 s is a machine that slept."""


class OwnPause:
    """Watches over the time between two looks of the engine.

    Parameters
    ----------
    clock : Clock
    record : callable
        Where a pause is logged.
    """

    def __init__(self, clock: Clock, record: Callable[[Record], None]) -> None:
        self._clock = clock
        self._record = record
        self._looked_ns: int | None = None

    def look(self) -> bool:
        """Tell whether bench stood still since the last look; called by the engine's thread at each turn."""
        now_ns = self._clock.now_ns()
        before_ns, self._looked_ns = self._looked_ns, now_ns
        if before_ns is None or now_ns - before_ns <= patience_ns(self._clock, LONGEST_TURN_S):
            return False
        paused_s = (now_ns - before_ns) / patience_ns(self._clock, 1.0)
        text = (
            f"bench itself stood still for {paused_s:.1f} s: this computer was suspended or too busy, or its terminal "
            "was stopped (Ctrl-S). What the devices sent meanwhile may be missing."
        )
        self._record(LogEntry(now_ns, Severity.WARN, "run", text))
        return True
