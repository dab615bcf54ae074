"""Drives the robot's program cycle by cycle, and always ends in a known state.

The engine knows roles, not devices: it grants cycles, waits for events, and never sees a marker frame.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field

from bench.drivers.base import ProgramControl, StateStream
from bench.errors import BenchError, CycleSequenceError, CycleTimeoutError, DeviceTimeoutError
from bench.model import CycleEvent, CycleEventKind, ExitStatus, Record, RunState
from bench.run.inbox import (
    AbortRequested,
    CycleCompleted,
    CycleStarted,
    Event,
    Fault,
    Inbox,
    ProgramPaused,
    StopRequested,
)
from bench.run.states import RunStates
from bench.run.watcher import PLAYING, CycleWatcher
from bench.timing import Clock, patience_ns

__all__ = ["Ending", "RunEngine", "RunLimits", "RunProgress"]


@dataclass(frozen=True, slots=True)
class RunLimits:
    """How long the engine waits for the robot."""

    start_s: float = 10.0
    """From a grant, or from `play`, until the robot shows that it obeys: its program needs one controller tick."""
    cycle_s: float = 600.0
    """One cycle; `[robot.cycle] timeout_s`."""


@dataclass(slots=True)
class RunProgress:
    """Where the run is, for the screen and for the closing words."""

    n_cycles: int
    n_completed: int = 0
    cycle_started_ns: int = -1
    """Host time of the current cycle's start; -1 between cycles."""
    run_started_ns: int = -1
    note: str = ""
    """What the operator should know or do now."""
    stop_requested: bool = False
    cycle_durations_ns: list[int] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Ending:
    """How a run ended."""

    status: ExitStatus
    reason: str


class _Aborted(Exception):  # noqa: N818 - no error: the operator's wish, on its way out of the loop
    """The operator asked for an end now."""


class RunEngine:
    """Runs N cycles of a program that is loaded and waits for its first grant."""

    def __init__(
        self,
        program: ProgramControl,
        stream: StateStream,
        watcher: CycleWatcher,
        inbox: Inbox,
        states: RunStates,
        clock: Clock,
        record: Callable[[Record], None],
        progress: RunProgress,
        limits: RunLimits,
        refresh: Callable[[], None] = lambda: None,
        *,
        is_granted: bool = True,
    ) -> None:
        self._program = program
        self._stream = stream
        self._watcher = watcher
        self._inbox = inbox
        self._states = states
        self._clock = clock
        self._record = record
        self._progress = progress
        self._limits = limits
        self._refresh = refresh
        self._is_granted = is_granted
        """Whether the program waits for a grant before each cycle; else it is stopped when it has driven enough."""

    def run(self) -> Ending:
        """Play the program, grant the cycles one by one, stop the program.

        Raises
        ------
        BenchError
            What ended the run early; the program has been told to stop and the state is ABORTING.
        """
        try:
            self._arm()
            self._states.enter(RunState.RUNNING)
            self._progress.run_started_ns = self._clock.now_ns()
            self._run_cycles()
        except _Aborted:
            return self._end_now("aborted by the operator")
        except BenchError as error:
            self._end_now(str(error))
            raise
        return self._end_orderly()

    def _arm(self) -> None:
        """Withdraw all grants before the program starts: registers keep the last run's values."""
        self._stream.grant_cycles(0)
        self._program.play()
        deadline = self._deadline(self._limits.start_s)
        while not self._waits_for_first_grant():
            self._take_event(deadline)
            if self._clock.now_ns() >= deadline:
                raise self._never_waited()
        self._watcher.arm()

    def _waits_for_first_grant(self) -> bool:
        state = self._watcher.latest
        return (
            state is not None
            and state.runtime_state in (PLAYING, -1)
            and state.cycle_count == 0
            and not (self._is_granted and state.cycle_running)
        )

    def _never_waited(self) -> DeviceTimeoutError:
        state = self._watcher.latest
        seen = "nothing" if state is None else f"counter {state.cycle_count}, running {state.cycle_running}"
        return DeviceTimeoutError(
            f"The robot program did not wait for its first cycle within {self._limits.start_s:g} s "
            f"(counter 0 and running 0 are expected, seen: {seen}).",
            hint="Is the bench snippet at the head of the program, with the registers of [robot.cycle]?",
        )

    def _run_cycles(self) -> None:
        for cycle_index in range(self._progress.n_cycles):
            if self._progress.stop_requested:
                return
            self._grant(cycle_index)
            start_s = self._limits.start_s if self._is_granted else self._limits.cycle_s
            self._await(CycleStarted(cycle_index), start_s, "start")
            self._progress.cycle_started_ns = self._clock.now_ns()
            self._await(CycleCompleted(cycle_index), self._limits.cycle_s, "end")
            self._progress.cycle_durations_ns.append(self._clock.now_ns() - self._progress.cycle_started_ns)
            self._progress.cycle_started_ns = -1
            self._progress.n_completed = cycle_index + 1
            self._refresh()

    def _grant(self, cycle_index: int) -> None:
        if not self._is_granted:
            return
        self._record(CycleEvent(self._clock.now_ns(), CycleEventKind.GRANTED, cycle_index))
        self._stream.grant_cycles(cycle_index + 1)

    def _await(self, expected: CycleStarted | CycleCompleted, limit_s: float, what: str) -> None:
        deadline = self._deadline(limit_s)
        while (event := self._take_event(deadline)) != expected:
            if isinstance(event, CycleStarted | CycleCompleted):
                raise CycleSequenceError(f"The robot reports {event} where {expected} is expected.")
            if self._clock.now_ns() >= deadline:
                raise CycleTimeoutError(
                    f"Cycle {expected.cycle_index} did not {what} within {limit_s:g} s.",
                    hint="Look at the robot's pendant; [robot.cycle] timeout_s is the limit for one cycle.",
                )

    def _take_event(self, deadline_ns: int) -> Event | None:
        event = self._inbox.wait(deadline_ns)
        match event:
            case Fault(error):
                raise error
            case AbortRequested():
                raise _Aborted
            case StopRequested():
                self._progress.stop_requested = True
                self._progress.note = "Stopping after this cycle. Press Ctrl-C again to abort now."
            case ProgramPaused(detail):
                self._progress.note = f"{detail} Resume it at the pendant, or press Ctrl-C twice to abort."
        self._refresh()
        return event

    def _deadline(self, limit_s: float) -> int:
        """At a scaled clock a machine still needs its own time to answer, so the longer of both counts."""
        return self._clock.now_ns() + max(round(limit_s * 1e9), patience_ns(self._clock, min(limit_s, 10.0)))

    def _end_orderly(self) -> Ending:
        done, wanted = self._progress.n_completed, self._progress.n_cycles
        stopped = done < wanted
        reason = (
            f"stopped by the operator after {done} of {wanted} cycles"
            if stopped
            else f"{done} of {wanted} cycles completed"
        )
        self._watcher.disarm()
        self._states.enter(RunState.STOPPING, reason)
        self._program.stop()
        return Ending(ExitStatus.ABORT if stopped else ExitStatus.SUCCESS, reason)

    def _end_now(self, reason: str) -> Ending:
        self._watcher.disarm()
        self._states.abort(reason)
        if self._progress.cycle_started_ns >= 0:
            cycle_index = self._progress.n_completed
            self._record(CycleEvent(self._clock.now_ns(), CycleEventKind.INTERRUPTED, cycle_index, detail=reason[:500]))
        with contextlib.suppress(BenchError):  # the first error counts; a stop that fails does not hide it
            self._stream.grant_cycles(0)
        with contextlib.suppress(BenchError):
            self._program.stop()
        return Ending(ExitStatus.ABORT, reason)
