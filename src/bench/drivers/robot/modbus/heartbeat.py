"""Signs of life in both directions: bench's, written between polls, and the controller's, which must keep changing."""

from __future__ import annotations

from bench.config import HeartbeatIn, HeartbeatOut, RegisterMap
from bench.drivers.robot.modbus.codec import wrap_to_type
from bench.drivers.robot.modbus.link import ModbusLink
from bench.drivers.robot.modbus.signals import write_signal
from bench.timing import Clock, patience_ns

__all__ = ["BeatWatch", "Beater"]


class Beater:
    """Writes bench's heartbeat when it is due. It stops when bench no longer polls, which is what it is for."""

    def __init__(self, signal: HeartbeatOut, register_map: RegisterMap, clock: Clock) -> None:
        self._signal = signal
        self._map = register_map
        self._clock = clock
        self._due_ns = 0
        self._n_beats = 0

    def beat(self, link: ModbusLink) -> None:
        """Write the next beat if it is time; raises like `ModbusLink.write`."""
        now_ns = self._clock.now_ns()
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + patience_ns(self._clock, self._signal.period_s)
        self._n_beats += 1
        write_signal(link, self._map, self._signal, self._next_value())

    def _next_value(self) -> float:
        if self._signal.beat == "toggle" or self._signal.type.startswith("f"):
            return self._n_beats % 2
        return wrap_to_type(self._signal.type, self._n_beats)


class BeatWatch:
    """Tells for how long the controller's heartbeat has not changed."""

    def __init__(self, signal: HeartbeatIn, clock: Clock) -> None:
        self.signal = signal
        self._clock = clock
        self._value: float | None = None
        self._changed_ns = clock.now_ns()

    def take(self, value: float) -> None:
        """Take the value of one reading into account."""
        if value != self._value:
            self._value, self._changed_ns = value, self._clock.now_ns()

    @property
    def is_late(self) -> bool:
        """Whether it has not changed for longer than it may."""
        return self._clock.now_ns() - self._changed_ns > patience_ns(self._clock, self.signal.max_age_s)
