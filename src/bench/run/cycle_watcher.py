"""Watches the robot's state stream for its cycles. Every package is seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from bench.errors import BenchError, CycleSequenceError, DeviceStateError
from bench.model import SAFETY_TEXTS, CycleEvent, CycleEventKind, Record, RobotState
from bench.run.inbox import CycleCompleted, CycleStarted, Event, Fault

__all__ = ["PLAYING", "CycleWatcher", "safety_text"]

PLAYING = 2
"""UR runtime state (UR RTDE guide)."""


def safety_text(status: int) -> str:
    """Return the name of a UR safety status."""
    return SAFETY_TEXTS.get(status, f"status {status}")


class CycleWatcher:
    """Turns consecutive robot states into cycle events; counts by the robot's own counter, never by time.

    Called from the state stream's reader thread. While not `armed` it only remembers the latest state.

    Parameters
    ----------
    notify : callable
        Told of cycles, by the robot's own count.
    record : callable
        Where the cycle events go, numbered from `first_cycle_index`.
    first_cycle_index : int, optional
        Cycles completed before the robot's counter was 0: those of the run that is gone on with.
    """

    def __init__(
        self,
        notify: Callable[[Event], None],
        record: Callable[[Record], None],
        first_cycle_index: int = 0,
        *,
        ends_at_next: bool = False,
        waiting: str = "",
    ) -> None:
        self._waiting = waiting
        """How a robot without a counter shows that it waits; empty where it counts itself."""
        self._ends_at_next = ends_at_next
        """Whether the next start ends a cycle; else a running mark that outlives the count is an old one."""
        self._notify = notify
        self._record = record
        self._first_cycle_index = first_cycle_index
        self._before: RobotState | None = None
        self._armed = False
        self.latest: RobotState | None = None
        """The newest state, None before the first."""

    @property
    def speed_fraction(self) -> float:
        """Where the speed slider stands, 0 to 1; NaN where that is not known."""
        return float("nan") if self.latest is None else self.latest.speed_fraction

    def describe_rest(self) -> tuple[str, str]:
        """Return how the program shows that it waits for its first cycle, and what it shows now."""
        state = self.latest
        expected = self._waiting or "counter 0 and running 0"
        if state is None:
            return expected, "nothing"
        if state.runtime_state not in (PLAYING, -1):
            return expected, "a program that does not play"
        if self._waiting:
            place = "on its path" if state.cycle_running else "waiting"
            return expected, f"the robot {place}, {state.cycle_count} cycles counted"
        return expected, f"counter {state.cycle_count}, running {state.cycle_running}"

    def arm(self) -> None:
        """Begin to report: from here on the program is ours."""
        latest = self.latest
        # a program that waits for no grant may have begun already: its start is still to be told
        self._before = None if latest is None else replace(latest, cycle_running=0)
        self._armed = True

    def disarm(self) -> None:
        """Stop reporting: what the robot does from here on is not the run's."""
        self._armed = False

    def update(self, state: RobotState) -> None:
        """Take one state into account."""
        before, self.latest = self._before, state
        if not self._armed:
            return
        self._before = state
        if before is not None:
            self._watch_cycles(before, state)

    def _watch_cycles(self, before: RobotState, state: RobotState) -> None:
        step = state.cycle_count - before.cycle_count
        if step == 1:
            self._mark(CycleEventKind.COMPLETED, state, before.cycle_count)
            self._notify(CycleCompleted(before.cycle_count))
        elif step != 0:
            self._notify(Fault(self._describe_jump(before, state)))
        if state.cycle_running == 1 and (before.cycle_running != 1 or (step == 1 and self._ends_at_next)):
            self._mark(CycleEventKind.STARTED, state, state.cycle_count)
            self._notify(CycleStarted(state.cycle_count))

    def _mark(self, kind: CycleEventKind, state: RobotState, cycle_index: int) -> None:
        self._record(CycleEvent(state.capture_ns, kind, self._first_cycle_index + cycle_index, state.controller_time_s))

    def _describe_jump(self, before: RobotState, state: RobotState) -> BenchError:
        if state.cycle_count < before.cycle_count and state.controller_time_s < before.controller_time_s:
            return _restarted(before, state, self._first_cycle_index + before.cycle_count)
        return _jumped(before, state)


def _restarted(before: RobotState, state: RobotState, cycle_index: int) -> DeviceStateError:
    return DeviceStateError(
        f"The robot's controller restarted in cycle {cycle_index}, and its program is gone: "
        f"its time went from {before.controller_time_s:.3f} s to {state.controller_time_s:.3f} s.",
        hint="See that robot and cable are well, make the robot ready again (its power, its brakes), then go on with "
        "--resume.",
    )


def _jumped(before: RobotState, state: RobotState) -> CycleSequenceError:
    return CycleSequenceError(
        f"The robot's cycle counter went from {before.cycle_count} to {state.cycle_count} "
        f"at controller time {state.controller_time_s:.3f} s; one at a time is expected.",
        hint="Was the robot restarted, another program started, or the register written by someone else? "
        "When that is clear, go on with --resume.",
    )
