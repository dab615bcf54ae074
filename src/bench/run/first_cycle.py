"""A first cycle that can be watched: the speed slider is lowered before the program starts, and set back after it."""

from __future__ import annotations

from collections.abc import Callable

from bench.drivers.base import SpeedControl
from bench.errors import DeviceTimeoutError
from bench.run.guards import SLIDER_STEP

__all__ = ["FirstCycle"]


class FirstCycle:
    """Where the speed slider stands in the first cycle, and where it is put afterwards. It asks; the engine waits.

    Parameters
    ----------
    slider : SpeedControl or None
        The robot's; None where it has none, or where the first cycle is like the others.
    fraction : float
        `[run] first_cycle_speed`. A slider that stands lower already is left alone.
    show : callable
        Where the slider stands, 0 to 1, by the newest robot state; NaN before the first.
    """

    def __init__(self, slider: SpeedControl | None, fraction: float, show: Callable[[], float]) -> None:
        self._slider = slider
        self._fraction = fraction
        self._show = show
        self._target = 1.0
        self.found = 1.0
        """Where the slider stood before it was lowered."""
        self.is_slow = False
        """Whether the slider is lowered, and not seen where it was yet."""

    @property
    def stretch(self) -> float:
        """How many times longer everything takes than it will afterwards."""
        return self.found / self._fraction if self.is_slow else 1.0

    @property
    def words(self) -> str:
        """How the cycle is driven; empty where it is like the others."""
        if not self.is_slow:
            return ""
        return f"driven with the speed slider at {100 * self._fraction:g}% ([run] first_cycle_speed)"

    def slow_down(self) -> None:
        """Ask for the low speed. `LinkLostError` if the robot cannot be asked."""
        self.found = self._show()
        if self._slider is not None and self.found > self._fraction:
            self.is_slow = True
            self._move(self._slider, self._fraction)

    def set_back(self) -> None:
        """Ask for the speed that was found. `LinkLostError` if the robot cannot be asked."""
        if self._slider is not None:
            self._move(self._slider, self.found)

    def _move(self, slider: SpeedControl, fraction: float) -> None:
        self._target = fraction
        slider.move_slider(fraction)

    @property
    def is_there(self) -> bool:
        """Whether the slider stands where it was asked to."""
        return not self.is_slow or round(abs(self._show() - self._target), 6) <= SLIDER_STEP

    def let_go(self) -> None:
        """Leave the slider to whoever wants to move it, once it is there."""
        if self._slider is not None and self.is_slow:
            self._slider.move_slider(None)
            self.is_slow = self._target != self.found

    def never_there(self, limit_s: float) -> DeviceTimeoutError:
        """Return the error of a slider that does not obey."""
        return DeviceTimeoutError(
            f"The speed slider stands at {self._show():.0%} and did not go to {self._target:.0%} within {limit_s:g} s.",
            hint="Set it at the pendant, or leave [run] first_cycle_speed out.",
        )
