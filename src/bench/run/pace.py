"""Tells whether a stream keeps up with the clock it claims to run on."""

from __future__ import annotations

from bench.timing import Clock, patience_ns

__all__ = ["PaceWatch"]

LARGEST_DRIFT = 500e-6
"""No quartz is further off; what exceeds it is delay, not drift."""
TOLERATED_S = 0.25
"""Machine time a stream may be late before its arrival times are called into question."""


class PaceWatch:
    """Follows how far a stream's arrivals fall behind its own time stamps.

    A simulated device that its machine cannot run at the asked speed, and a network that backs up, both show as
    arrivals that lag. Nothing is lost by it, but host times mapped from arrivals are worth less.
    """

    def __init__(self, clock: Clock) -> None:
        self._tolerated_ns = patience_ns(clock, TOLERATED_S)
        self._earliest: tuple[int, int] | None = None
        self.lag_ns = 0
        """Lag of the newest sample, nanoseconds of the run's clock."""
        self.largest_lag_ns = 0
        """Worst lag so far beyond any possible drift, nanoseconds of the run's clock."""

    def update(self, device_ns: int, arrival_ns: int) -> None:
        """Take one sample into account: its own time and its arrival, each in nanoseconds from any origin."""
        delay = arrival_ns - device_ns
        if self._earliest is None or delay < self._earliest[0] or device_ns < self._earliest[1]:
            self._earliest = (delay, device_ns)
            self.lag_ns = 0
            return
        lag = delay - self._earliest[0] - LARGEST_DRIFT * (device_ns - self._earliest[1])
        self.lag_ns = max(round(lag), 0)
        self.largest_lag_ns = max(self.largest_lag_ns, self.lag_ns)

    @property
    def is_behind(self) -> bool:
        """Whether the lag ever exceeded what is tolerated."""
        return self.largest_lag_ns > self._tolerated_ns
