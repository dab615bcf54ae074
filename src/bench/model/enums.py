"""Names for the numbers in a run file. The numbers are part of the file format and never change meaning."""

from __future__ import annotations

from enum import IntEnum, StrEnum

__all__ = [
    "SAFETY_TEXTS",
    "ClockSource",
    "CycleEventKind",
    "ExitStatus",
    "Outcome",
    "RunState",
    "Severity",
    "StampKind",
    "Verdict",
]

SAFETY_TEXTS = {
    1: "normal",
    2: "reduced",
    3: "protective stop",
    4: "recovery",
    5: "safeguard stop",
    6: "system emergency stop",
    7: "robot emergency stop",
    8: "violation",
    9: "fault",
}
"""UR safety status (UR RTDE guide)."""


class StampKind(IntEnum):
    """Which moment a tracker frame's device time denotes."""

    MID_EXPOSURE = 0
    """Middle of the exposure (Ethernet cameras)."""
    DATA_RECEIVED = 1
    """Camera data complete in the tracker PC (USB cameras send no mid-exposure stamp)."""
    FRAME_GRID = 2
    """Frame index over the take's exact export rate (imported files)."""
    FILE_TIME = 3
    """The time written in an imported file."""
    TRACKER_TIME = 4
    """The frame's time by a clock of the tracker that cannot be asked; which moment it is, is not told (Qualisys: us
    since the measurement began; NatNet 2: ns since its software's start)."""


class ClockSource(IntEnum):
    """Whose clock a `ClockSample` asked."""

    ROBOT = 0
    TRACKER = 1
    HOST = 2
    """The computer's own UTC clock, which NTP or a hand may move while the run's host time goes on evenly."""


class CycleEventKind(IntEnum):
    """What happened to a cycle."""

    GRANTED = 0
    STARTED = 1
    COMPLETED = 2
    INTERRUPTED = 3


class RunState(StrEnum):
    """Where a run is. `bench.run.states` holds the table of transitions."""

    IDLE = "IDLE"
    CONNECTING = "CONNECTING"
    CHECKING = "CHECKING"
    ARMED = "ARMED"
    RUNNING = "RUNNING"
    HOLDING = "HOLDING"
    STOPPING = "STOPPING"
    ABORTING = "ABORTING"
    CLOSING = "CLOSING"
    DONE = "DONE"


class ExitStatus(StrEnum):
    """Whether a run ended as it was meant to."""

    SUCCESS = "success"
    ABORT = "abort"
    FAIL = "fail"


class Outcome(StrEnum):
    """The verdict. FAIL is the cable; ERROR is the bench."""

    PASS = "PASS"  # noqa: S105 - a verdict, not a password
    FAIL = "FAIL"
    ERROR = "ERROR"


class Verdict(StrEnum):
    """The verdict on one cycle."""

    OK = "ok"
    INTERRUPTED = "interrupted"
    SLOW = "slow"
    GAP = "gap"


class Severity(IntEnum):
    """Levels of `rcl_interfaces/msg/Log`."""

    INFO = 20
    WARN = 30
    ERROR = 40
