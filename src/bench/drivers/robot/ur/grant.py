"""The grant of cycles: taken back when it is used, so that a program that begins anew finds none and stands.

A controller keeps what was written to an input register, over a lost link and over the end of the program. A grant left
there would move a program that somebody starts again, with nobody here to see it.
"""

from __future__ import annotations

from bench.model import RobotState

__all__ = ["Grant"]

NOT_RUNNING = (0, 1)
"""Runtime states of a program that is over: stopping, stopped."""


class Grant:
    """How many cycles the program may have begun, and whether it has begun them. Guarded by the lock of its owner."""

    def __init__(self) -> None:
        self.total = 0
        """What stands in the register; 0: nothing is granted."""
        self._n_runs = 0
        self._rested_count = -1

    def note_written(self, total: int, n_runs: int) -> None:
        """Remember what stands in the register, and which run of the program it is for (`SampleReader.n_runs`)."""
        self.total, self._n_runs = total, n_runs

    def note_state(self, state: RobotState) -> bool:
        """Take the newest sample into account; tell whether the granted cycles have begun, so that it is used.

        Only a program with a counter tells. Its mark may outlive its count by a sample, so the mark counts only after
        the program was seen at rest with that count.
        """
        if state.cycle_running == 0:
            self._rested_count = state.cycle_count
        if self.total <= 0:
            return False
        has_begun = state.cycle_running == 1 and state.cycle_count == self._rested_count == self.total - 1
        return has_begun or state.cycle_count >= self.total

    def is_for(self, state: RobotState | None, n_runs: int) -> bool:
        """Tell whether `state` shows the program run that the grant was given to."""
        if state is None or n_runs != self._n_runs:
            return False
        return state.runtime_state not in NOT_RUNNING and state.cycle_count <= self.total
