"""Drives the robot's program cycle by cycle, and always ends in a known state.

The engine knows roles, not devices: it grants cycles, waits for events, and never sees a marker frame.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from bench.drivers.base import ProgramControl, StateStream
from bench.errors import BenchError, CycleSequenceError, CycleTimeoutError, DeviceTimeoutError, LinkLostError
from bench.model import CycleEvent, CycleEventKind, ExitStatus, LogEntry, Record, RunState, Severity
from bench.run.conditions import Condition, describe_lost_link
from bench.run.cycle_watcher import PLAYING, CycleWatcher
from bench.run.first_cycle import FirstCycle
from bench.run.guards import Guards
from bench.run.holding import Holding
from bench.run.inbox import (
    AbortRequested,
    ConditionCleared,
    ConditionRaised,
    CycleCompleted,
    CycleStarted,
    Event,
    Fault,
    Inbox,
    StopRequested,
)
from bench.run.progress import Ending, RunLimits, RunProgress
from bench.run.states import RunStates
from bench.timing import Clock, patience_ns

__all__ = ["RunEngine"]


class _Aborted(Exception):  # noqa: N818 - no error: the operator's wish, on its way out of the loop
    """The operator asked for an end now."""


class RunEngine:
    """Runs N cycles of a program that is loaded and waits for its first grant."""

    def __init__(
        self,
        program: ProgramControl,
        stream: StateStream,
        watcher: CycleWatcher,
        guards: Guards,
        holding: Holding,
        inbox: Inbox,
        states: RunStates,
        clock: Clock,
        record: Callable[[Record], None],
        progress: RunProgress,
        limits: RunLimits,
        first_cycle: FirstCycle,
        refresh: Callable[[], None] = lambda: None,
        *,
        is_granted: bool = True,
    ) -> None:
        self._program = program
        self._stream = stream
        self._watcher = watcher
        self._guards = guards
        self._holding = holding
        self._inbox = inbox
        self._states = states
        self._clock = clock
        self._record = record
        self._progress = progress
        self._limits = limits
        self._first_cycle = first_cycle
        self._refresh = refresh
        self._is_granted = is_granted
        """Whether the program waits for a grant before each cycle; else it is stopped when it has driven enough."""
        self._hold_until_ns = 0
        self._interrupted: set[int] = set()

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
        self._first_cycle.slow_down()
        self._await_slider(lambda: False)
        self._program.play()
        deadline = self._deadline(self._limits.start_s * self._first_cycle.stretch)
        while not self._waits_for_first_grant():
            self._take_event(deadline)
            if self._clock.now_ns() >= deadline:
                raise self._never_waited()
        self._watcher.arm()
        self._guards.arm()

    def _waits_for_first_grant(self) -> bool:
        state = self._watcher.latest
        return (
            state is not None
            and state.runtime_state in (PLAYING, -1)
            and state.cycle_count == 0
            and not (self._is_granted and state.cycle_running)
        )

    def _never_waited(self) -> DeviceTimeoutError:
        expected, seen = self._watcher.describe_rest()
        return DeviceTimeoutError(
            f"The robot program did not wait for its first cycle within {self._limits.start_s:g} s "
            f"(expected: {expected}; seen: {seen}).",
            hint="Does it wait at its head, before anything moves, and is what tells its cycles configured as it is? "
            "A UR program needs the bench snippet at its head.",
        )

    def _run_cycles(self) -> None:
        first = self._progress.n_completed
        for count in range(self._progress.n_cycles - first):
            if not self._grant(first + count, count):
                return
            cycle_s = self._limits.cycle_s * self._first_cycle.stretch
            self._await(CycleStarted(count), self._limits.start_s if self._is_granted else cycle_s, "start")
            self._progress.cycle_started_ns = self._clock.now_ns()
            self._await(CycleCompleted(count), cycle_s, "end")
            self._progress.n_slowed += self._first_cycle.is_slow
            self._progress.cycle_durations_ns.append(self._clock.now_ns() - self._progress.cycle_started_ns)
            self._progress.cycle_started_ns = -1
            self._progress.n_completed = first + count + 1
            self._refresh()

    def _hold_between_cycles(self) -> None:
        """Grant nothing while a condition is present; a program that needs no grant can only be stopped."""
        if not self._is_granted:
            self._progress.stop_requested |= self._holding.stop_instead()
            return
        now_ns = self._clock.now_ns()
        while self._take_event_at_rest(now_ns):  # what is known already must count
            pass
        while self._holding.reason and not self._progress.stop_requested:
            self._enter_hold()
            self._take_event(self._hold_until_ns)
            self._verify_hold()
        self._leave_hold()

    def _take_event_at_rest(self, deadline_ns: int) -> Event | None:
        event = self._take_event(deadline_ns)
        if isinstance(event, CycleStarted | CycleCompleted):
            raise CycleSequenceError(f"The robot reports {event} though it was not granted.")
        return event

    def _enter_hold(self) -> None:
        if self._states.state is RunState.HOLDING:
            return
        self._states.enter(RunState.HOLDING, self._holding.reason)
        self._hold_until_ns = self._deadline(self._limits.hold_s)

    def _verify_hold(self) -> None:
        if self._clock.now_ns() >= self._hold_until_ns:
            raise DeviceTimeoutError(
                f"The run has held for {self._limits.hold_s:g} s, the limit: {self._holding.reason}",
                hint="Go on with --resume. [policy] hold_timeout_s is the limit.",
            )

    def _leave_hold(self) -> None:
        if self._states.state is RunState.HOLDING and not self._holding.reason:
            self._states.enter(RunState.RUNNING, "as before again")

    def _grant(self, cycle_index: int, count: int) -> bool:
        """Grant one more cycle as soon as nothing speaks against it; False if the run is to end instead."""
        while True:
            self._hold_between_cycles()
            if self._progress.stop_requested:
                return False
            now_ns = self._clock.now_ns()
            try:
                if count > 0 and not self._is_at_full_speed():
                    continue
                if self._is_granted:
                    self._stream.grant_cycles(count + 1)
            except LinkLostError as error:
                self._take_condition(describe_lost_link(error, now_ns))
                continue
            if self._is_granted:
                self._record(CycleEvent(now_ns, CycleEventKind.GRANTED, cycle_index, detail=self._first_cycle.words))
            return True

    def _is_at_full_speed(self) -> bool:
        """Set the slider back after the first cycle; False if something else must be seen to first."""
        first = self._first_cycle
        if not first.is_slow:
            return True
        self._guards.expect_speed(float("nan"))
        first.set_back()
        if not self._await_slider(lambda: bool(self._holding.reason) or self._progress.stop_requested):
            return False
        self._guards.expect_speed(first.found)
        text = f"The first cycle is driven; the speed slider is back at {first.found:.0%}."
        self._record(LogEntry(self._clock.now_ns(), Severity.INFO, "run", text))
        return True

    def _await_slider(self, is_put_off: Callable[[], bool]) -> bool:
        """Wait until the robot shows the slider where it was asked for; False if that is put off."""
        limit_s = self._limits.start_s
        deadline = self._deadline(limit_s)
        while not self._first_cycle.is_there:
            self._take_event_at_rest(deadline)
            if is_put_off():
                return False
            if self._clock.now_ns() >= deadline:
                raise self._first_cycle.never_there(limit_s)
        self._first_cycle.let_go()
        return True

    def _leave_slider(self) -> None:
        """Set the slider back after the program's end; a robot that may still move keeps its low speed."""
        first = self._first_cycle
        if not first.is_slow:
            return
        with contextlib.suppress(BenchError):
            self._program.stop()
            first.set_back()
            deadline = self._deadline(self._limits.start_s)
            while not first.is_there and self._clock.now_ns() < deadline:
                self._inbox.wait(deadline)
            if first.is_there:
                first.let_go()
                return
        self._warn(f"The speed slider was left low; before the run it stood at {first.found:.0%}.")

    def _await(self, expected: CycleStarted | CycleCompleted, limit_s: float, what: str) -> None:
        deadline = self._deadline(limit_s)
        while (event := self._take_event(deadline)) != expected:
            if event == CycleCompleted(expected.cycle_index):  # a cycle of which only the end was seen
                self._inbox.put(event)
                return
            if isinstance(event, CycleStarted | CycleCompleted):
                raise CycleSequenceError(f"The robot reports {event} where {expected} is expected.")
            if self._holding.is_due_at_once:
                deadline = self._wait_out(deadline)
            elif self._clock.now_ns() >= deadline:
                raise CycleTimeoutError(
                    f"Cycle {self._progress.n_completed} did not {what} within {limit_s:g} s.",
                    hint="Look at the robot and its controller; [robot.cycle] timeout_s is the limit for one cycle.",
                )

    def _wait_out(self, deadline_ns: int) -> int:
        """Hold in the middle of a cycle, for the robot stands; return the deadline put off by that time.

        Returns early with each cycle event: it is put back, for whoever waits for it.
        """
        began_ns = self._clock.now_ns()
        self._enter_hold()
        while self._holding.is_due_at_once:
            event = self._take_event(self._hold_until_ns)
            if isinstance(event, CycleStarted | CycleCompleted):
                self._inbox.put(event)
                break
            self._verify_hold()
        self._leave_hold()
        return deadline_ns + self._clock.now_ns() - began_ns

    def _take_event(self, deadline_ns: int) -> Event | None:
        event = self._inbox.wait(deadline_ns)
        self._guards.poll(self._progress.n_completed, self._progress.n_cycles)
        match event:
            case Fault(error):
                raise error
            case AbortRequested():
                raise _Aborted
            case StopRequested():
                self._progress.stop_requested = True
            case ConditionRaised(condition):
                self._take_condition(condition)
            case ConditionCleared(kind):
                self._holding.remove(kind)
        self._progress.note = self._describe()
        self._refresh()
        return event

    def _take_condition(self, condition: Condition) -> None:
        if condition.stops_robot and self._progress.cycle_started_ns >= 0:
            self._interrupt(condition.host_ns, condition.text)
        self._holding.add(condition)
        self._progress.stop_requested |= bool(self._holding.stop_reason)

    def _interrupt(self, host_ns: int, detail: str) -> None:
        """Mark the cycle under way, once."""
        cycle_index = self._progress.n_completed
        if cycle_index not in self._interrupted:
            self._interrupted.add(cycle_index)
            self._record(CycleEvent(host_ns, CycleEventKind.INTERRUPTED, cycle_index, detail=detail[:500]))

    def _describe(self) -> str:
        stopping = (
            "Stopping after this cycle. Press Ctrl-C again to abort now." if self._progress.stop_requested else ""
        )
        note = self._holding.note
        if note and self._states.state is not RunState.HOLDING:
            note = f"No further cycle for now: {note}"
        slow = f"The first cycle is {self._first_cycle.words}: watch it." if self._first_cycle.is_slow else ""
        parts = (note, self._holding.stop_reason if not note else "", stopping, slow)
        return " ".join(part for part in parts if part)

    def _deadline(self, limit_s: float) -> int:
        """At a scaled clock a machine still needs its own time to answer, so the longer of both counts."""
        return self._clock.now_ns() + max(round(limit_s * 1e9), patience_ns(self._clock, min(limit_s, 10.0)))

    def _end_orderly(self) -> Ending:
        done, wanted = self._progress.n_completed, self._progress.n_cycles
        stopped = done < wanted
        reason = (
            f"stopped {self._find_stopper()} after {done} of {wanted} cycles"
            if stopped
            else f"{done} of {wanted} cycles completed"
        )
        self._disarm()
        self._states.enter(RunState.STOPPING, reason)
        self._stop_program()
        self._leave_slider()
        return Ending(ExitStatus.ABORT if stopped else ExitStatus.SUCCESS, reason)

    def _find_stopper(self) -> str:
        cause = self._holding.stop_reason
        return f"by the policy for this: {cause.rstrip('.')};" if cause else "by the operator"

    def _stop_program(self) -> None:
        """Stop the program; if it will not, it waits for a grant that does not come, and the cycles are driven anyway.

        A program that waits for no grant goes on, so there it is an error.
        """
        try:
            self._program.stop()
        except BenchError as error:
            if not self._is_granted:
                raise
            self._warn(f"The robot program was not stopped and waits for its next cycle: {error}")

    def _warn(self, text: str) -> None:
        self._progress.warnings.append(text)
        self._record(LogEntry(self._clock.now_ns(), Severity.WARN, "run", text))

    def _disarm(self) -> None:
        self._watcher.disarm()
        self._guards.disarm()

    def _end_now(self, reason: str) -> Ending:
        self._disarm()
        self._states.abort(reason)
        if self._progress.cycle_started_ns >= 0:
            self._interrupt(self._clock.now_ns(), reason)
        with contextlib.suppress(BenchError):  # the first error counts; a stop that fails does not hide it
            self._stream.grant_cycles(0)
        with contextlib.suppress(BenchError):
            self._program.stop()
        self._leave_slider()
        return Ending(ExitStatus.ABORT, reason)
