"""What happens while a run waits: one queue of events, filled by reader threads and signals."""

from __future__ import annotations

import queue
from dataclasses import dataclass
from typing import Protocol

from bench.errors import BenchError
from bench.run.conditions import Condition, ConditionKind
from bench.timing import Clock, patience_ns

__all__ = [
    "AbortRequested",
    "ConditionCleared",
    "ConditionRaised",
    "CycleCompleted",
    "CycleStarted",
    "Event",
    "Fault",
    "Inbox",
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
class ConditionRaised:
    """Something is not as the run needs it; again, when the advice on it has changed."""

    condition: Condition


@dataclass(frozen=True, slots=True)
class ConditionCleared:
    """It is as the run needs it again."""

    kind: ConditionKind


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


Event = CycleStarted | CycleCompleted | ConditionRaised | ConditionCleared | Fault | StopRequested | AbortRequested


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
