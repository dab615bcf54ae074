"""What may go wrong with a bench while it runs, and what the operator does about it. `[policy]` has a key for each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from bench.errors import BenchError, DeviceStateError, LinkLostError

__all__ = ["Condition", "ConditionKind", "describe_lost_link"]


class ConditionKind(StrEnum):
    """The kinds of conditions; the values are the keys of `[policy]`."""

    TRACKER_SILENT = "tracker_silent"
    ROBOT_LINK_LOST = "robot_link_lost"
    PROTECTIVE_STOP = "protective_stop"
    SAFEGUARD_STOP = "safeguard_stop"
    EMERGENCY_STOP = "emergency_stop"
    SLIDER_MOVED = "slider_moved"
    PROGRAM_REPLACED = "program_replaced"
    DISK_LOW = "disk_low"
    CLOCK_RESIDUAL = "clock_residual"
    PROGRAM_PAUSED = "program_paused"
    """A person paused the program at the pendant. No policy: the run waits for that person."""


ROBOT_STOPS = frozenset(
    {
        ConditionKind.PROTECTIVE_STOP,
        ConditionKind.SAFEGUARD_STOP,
        ConditionKind.EMERGENCY_STOP,
        ConditionKind.PROGRAM_REPLACED,
        ConditionKind.PROGRAM_PAUSED,
    }
)


@dataclass(frozen=True, slots=True)
class Condition:
    """Something that is not as a run needs it."""

    kind: ConditionKind
    host_ns: int
    """When it was seen."""
    text: str
    """One sentence: what is the matter."""
    advice: str
    """What the operator does next."""
    error: type[BenchError] = DeviceStateError
    """What it is raised as where it ends the run."""

    @property
    def stops_robot(self) -> bool:
        """Whether the robot stands still because of it, wherever on its path it is."""
        return self.kind in ROBOT_STOPS

    @property
    def holds_at_once(self) -> bool:
        """Whether a hold cannot wait for the end of the cycle: the robot stands, or nothing is heard of it."""
        return self.stops_robot or self.kind is ConditionKind.ROBOT_LINK_LOST

    def to_error(self, more: str = "") -> BenchError:
        """Return the error that ends the run."""
        return self.error(f"{self.text} {more}".strip(), hint=self.advice)


def describe_lost_link(error: BenchError, host_ns: int) -> Condition:
    """Return the condition of a robot that cannot be heard, or not be granted a cycle."""
    advice = f"{error.hint or 'Look at the robot and its network cable.'} It goes on when the robot answers again."
    return Condition(ConditionKind.ROBOT_LINK_LOST, host_ns, str(error.args[0]), advice, LinkLostError)
