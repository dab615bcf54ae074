"""Counters and clocks that start again at the end of their register."""

from __future__ import annotations

__all__ = ["CounterUnwrapper", "TimeUnwrapper"]

TOLERANCE_S = 2.0
"""How much a controller's time may differ from ours between two polls before it has been restarted."""
TOLERANCE_RATIO = 0.01
"""The same over longer outages; a controller's clock is far better than 1 %."""


class CounterUnwrapper:
    """Follows a counter beyond its register's end.

    A step forwards of less than half the range is counting, wrapped or not. Any other is a counter set anew: the
    count is then what the register says.

    Parameters
    ----------
    n_counts : int
        How many values it has before it is 0 again.
    """

    def __init__(self, n_counts: int) -> None:
        self._range = n_counts
        self._raw: int | None = None
        self.count = 0
        """The count after the last `take`."""

    def begin_anew(self) -> None:
        """Take the next value as it stands: a controller that was restarted has not counted to it."""
        self._raw = None

    def take(self, raw: int) -> int:
        """Return the count that goes with what the register holds, with or without sign."""
        value = raw % self._range
        step = 0 if self._raw is None else (value - self._raw) % self._range
        if self._raw is None or step >= self._range // 2:
            self.count = value
        else:
            self.count += step
        self._raw = value
        return self.count


class TimeUnwrapper:
    """Follows a controller's own time beyond its register's end, and tells when the controller was restarted.

    Parameters
    ----------
    n_bits : int
        Width of the register; 0 for floating point, which does not wrap.
    tick_s : float
        Seconds for each count.
    """

    def __init__(self, n_bits: int, tick_s: float) -> None:
        self._range = (1 << n_bits) if n_bits else 0
        self._tick_s = tick_s
        self._raw: float | None = None
        self._ticks = 0.0
        self.n_restarts = 0
        """How often the controller's time began anew."""

    def take(self, raw: float, elapsed_s: float) -> float:
        """Return the controller's time in seconds.

        Parameters
        ----------
        raw : float
            What the register holds.
        elapsed_s : float
            Our own time since the last call.
        """
        before, self._raw = self._raw, raw
        if before is None:
            self._ticks = raw % self._range if self._range else raw
            return self._ticks * self._tick_s
        step = (raw - before) % self._range if self._range else raw - before
        passed_s = elapsed_s % (self._range * self._tick_s) if self._range else elapsed_s
        if abs(step * self._tick_s - passed_s) > TOLERANCE_S + TOLERANCE_RATIO * elapsed_s and not self._is_near(step):
            self.n_restarts += 1
            self._ticks = raw % self._range if self._range else raw
        else:
            self._ticks += step
        return self._ticks * self._tick_s

    def _is_near(self, step: float) -> bool:
        """Tell whether the time stood still, as of a controller that refreshes its registers slowly."""
        return 0 <= step * self._tick_s <= TOLERANCE_S
