"""The table of run states, the closing steps and the inbox."""

from __future__ import annotations

import threading

import pytest

from bench.errors import IllegalTransitionError
from bench.model import RunState
from bench.run.closing import Closing
from bench.run.inbox import AbortRequested, QueueInbox, StopRequested
from bench.run.states import TRANSITIONS, RunStates
from bench.timing import ManualClock, RunClock


def test_every_state_before_closing_can_abort_and_no_later_one() -> None:
    can_abort = {state for state, after in TRANSITIONS.items() if RunState.ABORTING in after}
    assert can_abort == set(RunState) - {RunState.ABORTING, RunState.CLOSING, RunState.DONE}


def test_every_state_leads_to_done() -> None:
    for start in RunState:
        seen, frontier = {start}, {start}
        while frontier:
            frontier = {after for state in frontier for after in TRANSITIONS[state]} - seen
            seen |= frontier
        assert RunState.DONE in seen


def test_an_illegal_step_is_refused_and_not_recorded() -> None:
    records: list[object] = []
    states = RunStates(ManualClock(), records.append)
    with pytest.raises(IllegalTransitionError, match="from IDLE to RUNNING"):
        states.enter(RunState.RUNNING)
    assert records == []
    assert states.state is RunState.IDLE


def test_closing_runs_every_step_in_reverse_and_raises_the_first_error() -> None:
    done: list[str] = []

    def fail(name: str) -> None:
        done.append(name)
        raise ValueError(name)

    closing = Closing()
    with pytest.raises(ValueError, match="second"), closing:
        closing.add("first", lambda: fail("first"))
        closing.add("second", lambda: fail("second"))
        closing.add("third", lambda: done.append("third"))
    assert done == ["third", "second", "first"]
    assert len(closing.notes) == 2


def test_closing_never_hides_the_error_of_the_run() -> None:
    with pytest.raises(KeyError), Closing() as closing:
        closing.add("a device", lambda: 1 / 0)
        raise KeyError


def test_a_step_that_hangs_does_not_keep_the_others_open() -> None:
    release = threading.Event()
    done: list[str] = []
    closing = Closing()
    closing.add("the file", lambda: done.append("file"))
    closing.add("a device that hangs", release.wait, limit_s=0.05)
    error = closing.run()
    release.set()
    assert isinstance(error, TimeoutError)
    assert done == ["file"]


def test_the_inbox_returns_events_in_order_and_none_at_its_deadline() -> None:
    clock = RunClock.start(speed=50.0)
    inbox = QueueInbox(clock)
    inbox.put(StopRequested())
    inbox.put(AbortRequested())
    assert inbox.wait(clock.now_ns() + 10**9) == StopRequested()
    assert inbox.wait(clock.now_ns() - 1) == AbortRequested()
    assert inbox.wait(clock.now_ns()) is None
