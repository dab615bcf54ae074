"""Host time: Unix nanoseconds computed from one (monotonic, UTC) pair per run, so that NTP cannot bend it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

from bench.errors import ConfigError

__all__ = ["Clock", "ManualClock", "RunClock", "patience_ns"]


class Clock(Protocol):
    """What everything that needs the time is given."""

    @property
    def speed(self) -> float:
        """Seconds of this clock that pass in one second of the machine's own time."""
        ...

    def now_ns(self) -> int:
        """Unix nanoseconds."""
        ...

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return when `now_ns` has reached the absolute deadline."""
        ...


@dataclass(frozen=True, slots=True)
class RunClock:
    """The clock of a run: the machine's monotonic clock, pinned once to UTC, `speed` times as fast.

    Processes that share the same pair and speed share the same time, which is how the simulated bench and the
    run agree. Waiting times for links and machines (not for robots) are given in the machine's own seconds: see
    `patience_ns`.

    Parameters
    ----------
    monotonic_ns, utc_ns : int
        One moment, read on both clocks.
    speed : float
        1 for anything real; more makes the simulated bench faster than real time.
    """

    monotonic_ns: int
    utc_ns: int
    speed: float = 1.0

    @classmethod
    def start(cls, speed: float = 1.0) -> RunClock:
        """Pin a new clock to the present moment."""
        return cls(time.monotonic_ns(), time.time_ns(), speed)

    @classmethod
    def from_text(cls, text: str) -> RunClock:
        """Read what `to_text` wrote; `ConfigError` if it is something else."""
        try:
            monotonic, utc, speed = text.split(":")
            return cls(int(monotonic), int(utc), float(speed))
        except ValueError as error:
            raise ConfigError(f"'{text}' is no clock: MONOTONIC_NS:UTC_NS:SPEED is expected.") from error

    def to_text(self) -> str:
        """Return the pair and the speed in one word, for another process."""
        return f"{self.monotonic_ns}:{self.utc_ns}:{self.speed!r}"

    def at_monotonic_ns(self, monotonic_ns: int) -> int:
        """Map a reading of the machine's monotonic clock to Unix nanoseconds."""
        elapsed = monotonic_ns - self.monotonic_ns
        return self.utc_ns + (elapsed if self.speed == 1.0 else round(elapsed * self.speed))

    def now_ns(self) -> int:
        return self.at_monotonic_ns(time.monotonic_ns())

    def sleep_until_ns(self, deadline_ns: int) -> None:
        while (left := deadline_ns - self.now_ns()) > 0:
            time.sleep(left / self.speed * 1e-9)


class ManualClock:
    """A clock that moves when it is told to: for tests, and for replaying."""

    speed = 1.0

    def __init__(self, now_ns: int = 1_700_000_000_000_000_000) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        return self._now_ns

    def advance_ns(self, delta_ns: int) -> None:
        self._now_ns += delta_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        self._now_ns = max(self._now_ns, deadline_ns)


def patience_ns(clock: Clock, seconds: float) -> int:
    """Return `seconds` of the machine's own time as a duration of `clock`.

    A link or a disk does not become faster because simulated time does, so the limits on them are not scaled.
    """
    return round(seconds * 1e9 * clock.speed)
