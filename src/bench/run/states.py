"""The states of a run and the one table of transitions between them."""

from __future__ import annotations

from collections.abc import Callable

from bench.errors import IllegalTransitionError
from bench.model import Record, RunState, StateChange
from bench.timing import Clock

__all__ = ["TRANSITIONS", "RunStates"]

_BEFORE_CLOSING = {
    RunState.IDLE: {RunState.CONNECTING},
    RunState.CONNECTING: {RunState.CHECKING},
    RunState.CHECKING: {RunState.ARMED, RunState.CLOSING},
    RunState.ARMED: {RunState.RUNNING},
    RunState.RUNNING: {RunState.HOLDING, RunState.STOPPING},
    RunState.HOLDING: {RunState.RUNNING, RunState.STOPPING},
    RunState.STOPPING: {RunState.CLOSING},
}
TRANSITIONS: dict[RunState, set[RunState]] = {
    **{state: after | {RunState.ABORTING} for state, after in _BEFORE_CLOSING.items()},
    RunState.ABORTING: {RunState.CLOSING},
    RunState.CLOSING: {RunState.DONE},
    RunState.DONE: set(),
}
"""Which states may follow which. Checks alone go from CHECKING to CLOSING; every error goes through ABORTING."""


class RunStates:
    """Where a run is; each entry is recorded with its reason."""

    def __init__(self, clock: Clock, record: Callable[[Record], None]) -> None:
        self._clock = clock
        self._record = record
        self.state = RunState.IDLE

    def enter(self, state: RunState, reason: str = "") -> None:
        """Go to `state`; `IllegalTransitionError` if the table does not hold that step."""
        if state not in TRANSITIONS[self.state]:
            raise IllegalTransitionError(f"A run cannot go from {self.state} to {state}.")
        self.state = state
        self._record(StateChange(self._clock.now_ns(), state, reason))

    def abort(self, reason: str) -> None:
        """Go to ABORTING from any state before CLOSING; later than that there is nothing left to abort."""
        if RunState.ABORTING in TRANSITIONS[self.state]:
            self.enter(RunState.ABORTING, reason)
