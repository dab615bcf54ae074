"""What an execution of the engine is held to, where it is, and how it ended."""

from __future__ import annotations

from dataclasses import dataclass, field

from bench.model import ExitStatus

__all__ = ["Ending", "RunLimits", "RunProgress"]


@dataclass(frozen=True, slots=True)
class RunLimits:
    """How long the engine waits for the robot."""

    start_s: float = 10.0
    """From a grant, or from `play`, until the robot shows that it obeys: its program needs one controller tick."""
    cycle_s: float = 600.0
    """One cycle, without the time in which the robot stood; `[robot.cycle] timeout_s`."""
    hold_s: float = 43_200.0
    """One hold; `[policy] hold_timeout_s`."""


@dataclass(slots=True)
class RunProgress:
    """Where the run is, for the screen and for the closing words."""

    n_cycles: int
    """In all, those of the run that is gone on with included."""
    n_completed: int = 0
    """The same; what it is before the first cycle, the robot's counter starts after."""
    cycle_started_ns: int = -1
    """Host time of the current cycle's start; -1 between cycles."""
    run_started_ns: int = -1
    note: str = ""
    """What the operator should know or do now."""
    stop_requested: bool = False
    cycle_durations_ns: list[int] = field(default_factory=list)
    n_slowed: int = 0
    """How many of these, the first ones, were driven slower on purpose: they do not foretell the others."""
    warnings: list[str] = field(default_factory=list)
    """What the operator must know when the run is over."""


@dataclass(frozen=True, slots=True)
class Ending:
    """How a run ended."""

    status: ExitStatus
    reason: str
