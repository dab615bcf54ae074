"""One thread that lets everything simulated happen in the order of simulated time.

Robot ticks, exposures and packets share one queue, so that the robot's pose and the cable's shape agree at every
instant however late the machine is. Nothing is skipped: on a machine that cannot keep up, simulated devices lag.
"""

from __future__ import annotations

import heapq
import itertools
import threading
from collections.abc import Callable

from bench.timing import Clock

__all__ = ["Scheduler"]

LONGEST_WAIT_NS = 20_000_000
"""How long, in machine time, a stop or an earlier deadline may go unnoticed: 20 ms."""


class Scheduler:
    """Runs actions at absolute times of a clock, in order, each with the time it was due."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._queue: list[tuple[int, int, Callable[[int], None]]] = []
        self._order = itertools.count()
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self.largest_lag_ns = 0
        """Worst lateness of an action so far, in nanoseconds of the clock."""

    def call_at(self, due_ns: int, action: Callable[[int], None]) -> None:
        """Run `action(due_ns)` on the scheduler's thread at `due_ns`. May be called from any thread."""
        with self._lock:
            heapq.heappush(self._queue, (due_ns, next(self._order), action))

    def stop(self) -> None:
        """Make `run` return. May be called from any thread."""
        self._stopped.set()

    def run(self) -> None:
        """Run what is due until `stop` is called; the caller's thread is the scheduler's thread."""
        while not self._stopped.is_set():
            now_ns = self._clock.now_ns()
            due = self._take(now_ns)
            if due is None:
                self._wait(now_ns)
                continue
            due_ns, action = due
            self.largest_lag_ns = max(self.largest_lag_ns, now_ns - due_ns)
            action(due_ns)

    def _take(self, now_ns: int) -> tuple[int, Callable[[int], None]] | None:
        with self._lock:
            if not self._queue or self._queue[0][0] > now_ns:
                return None
            due_ns, _, action = heapq.heappop(self._queue)
            return due_ns, action

    def _wait(self, now_ns: int) -> None:
        longest = now_ns + round(LONGEST_WAIT_NS * self._clock.speed)
        with self._lock:
            next_ns = self._queue[0][0] if self._queue else longest
        self._clock.sleep_until_ns(min(next_ns, longest))
