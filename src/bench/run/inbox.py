"""What happens while a run waits: one queue of events, filled by reader threads and signals."""

from __future__ import annotations

import queue
from dataclasses import dataclass
from typing import Protocol

from bench.errors import BenchError
from bench.timing import Clock, patience_ns

__all__ = [
    "AbortRequested",
    "CycleCompleted",
    "CycleStarted",
    "Event",
    "Fault",
    "Inbox",
    "ProgramPaused",
    "QueueInbox",
    "StopRequested",
]

LONGEST_WAIT_S = 0.25
"""The screen is redrawn four times a second: slow enough to cost nothing, quick enough to look alive."""


@dataclass(frozen=True, slots=True)
class CycleStarted:
    """The robot left the start of its path."""

    cycle_index: int


@dataclass(frozen=True, slots=True)
class CycleCompleted:
    """The robot's counter went up by one."""

    cycle_index: int


@dataclass(frozen=True, slots=True)
class ProgramPaused:
    """The robot program is paused: by its pendant, by a protective or a safeguard stop."""

    detail: str


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that ends the run."""

    error: BenchError


@dataclass(frozen=True, slots=True)
class StopRequested:
    """The operator wants the run to end after this cycle (first Ctrl-C)."""


@dataclass(frozen=True, slots=True)
class AbortRequested:
    """The operator wants the run to end now (second Ctrl-C)."""


Event = CycleStarted | CycleCompleted | ProgramPaused | Fault | StopRequested | AbortRequested


class Inbox(Protocol):
    """Where the engine waits."""

    def put(self, event: Event) -> None:
        """Add an event; from any thread, and from a signal handler."""
        ...

    def wait(self, deadline_ns: int) -> Event | None:
        """Return the next event, or None after a short while or at the deadline, whichever is first."""
        ...


class QueueInbox:
    """The inbox of a real run."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()

    def put(self, event: Event) -> None:
        self._events.put(event)

    def wait(self, deadline_ns: int) -> Event | None:
        left_s = (deadline_ns - self._clock.now_ns()) / patience_ns(self._clock, 1.0)
        try:
            return self._events.get(timeout=min(max(left_s, 0.001), LONGEST_WAIT_S))
        except queue.Empty:
            return None
