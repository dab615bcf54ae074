"""The roles a device can play for a run. Small Protocols; drivers push, nobody polls them for data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from bench.model import DeviceInfo, Record

__all__ = [
    "ProgramControl",
    "ProgramTeller",
    "RecordSink",
    "ShownSignal",
    "SignalWatch",
    "SpeedControl",
    "StateStream",
    "TrackerStream",
]

RecordSink = Callable[[Record], None]
"""Where a driver pushes its records, from its own reader thread. It never blocks and never raises."""


class StateStream(Protocol):
    """The robot's state, every sample of it, and the register that lets it begin a cycle."""

    def open(self, sink: RecordSink) -> DeviceInfo:
        """Connect and start pushing `RobotState` (and `LogEntry` for link events) into `sink`.

        Raises
        ------
        ConnectError, ProtocolError, DeviceStateError
            The controller cannot be reached, speaks another protocol, or refuses the recipe.
        """
        ...

    def grant_cycles(self, total: int) -> None:
        """Allow the program to have begun `total` cycles since it started. `LinkLostError` if it cannot be sent.

        Does nothing where `[robot.cycle]` says that the program waits for no grant.
        """
        ...

    def close(self) -> None:
        """Stop the reader thread and close the connection. May be called twice, and after an error."""
        ...


@runtime_checkable
class SpeedControl(Protocol):
    """The speed slider of a robot whose controller lets others move it; some state streams play this role too."""

    def move_slider(self, fraction: float | None) -> None:
        """Ask for the slider to stand at `fraction`, 0.02 to 1; None: ask for nothing any more, so that a person can.

        The state stream shows when it is there. `LinkLostError` if it cannot be sent.
        """
        ...


class ProgramControl(Protocol):
    """Load, start and stop the robot's own program. Each call returns when the effect is seen, not when it is asked."""

    @property
    def ready_when(self) -> str:
        """What `check` asks of this controller, in a few words; once it is open."""
        ...

    def open(self) -> None:
        """Connect. `ConnectError` if the controller cannot be reached."""
        ...

    def check(self, program: str) -> list[str]:
        """Return one sentence for each reason why `program` cannot be run now; empty if it can."""
        ...

    def load(self, program: str) -> None: ...

    def play(self) -> None: ...

    def stop(self) -> None: ...

    def close(self) -> None: ...


@runtime_checkable
class ProgramTeller(Protocol):
    """A program control whose controller tells more of its loaded program than the name; some play this role too."""

    def tell_loaded(self) -> dict[str, str]:
        """Return ``loaded``, its name or path there, and of its content ``loaded_sha256`` and ``loaded_bytes``.

        What the controller cannot tell is left out. `DeviceError` if it does not answer.
        """
        ...


@dataclass(frozen=True, slots=True)
class ShownSignal:
    """One value of a controller, in words."""

    name: str
    value: str
    place: str = ""
    """Where it stands on the controller and how, as far as the configuration says it."""


class SignalWatch(Protocol):
    """Looks at a controller without touching it: for whoever sets it up."""

    def open(self) -> None:
        """Connect. Raises like `StateStream.open`."""
        ...

    def read(self) -> list[ShownSignal]:
        """Return every signal as it is now. `DeviceError` if the controller does not tell."""
        ...

    def close(self) -> None:
        """Close the connection. May be called twice, and after an error."""
        ...


class TrackerStream(Protocol):
    """What the cameras saw, every frame of it, and how the tracker's clock relates to ours."""

    def open(self, sink: RecordSink) -> DeviceInfo:
        """Connect and start pushing `TrackerFrame`, `ClockSample` and `LogEntry` into `sink`.

        Raises
        ------
        ConnectError, ProtocolError
            The tracker cannot be reached, or speaks another protocol.
        """
        ...

    def close(self) -> None:
        """Stop the reader thread and close the sockets. May be called twice, and after an error."""
        ...
