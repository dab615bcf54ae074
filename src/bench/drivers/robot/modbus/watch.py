"""Every signal of a register map, decoded: for whoever puts the map together."""

from __future__ import annotations

from bench.config import ModbusRobotConfig, Signal, VectorSignal
from bench.drivers.base import ShownSignal
from bench.drivers.robot.modbus.link import ModbusLink
from bench.drivers.robot.modbus.samples import is_open, name_state
from bench.drivers.robot.modbus.signals import Reading, SignalReader
from bench.timing import Clock

__all__ = ["ModbusSignalWatch"]


class ModbusSignalWatch:
    """`SignalWatch` of a controller with a Modbus TCP server. What bench writes is read back; nothing is written."""

    def __init__(self, config: ModbusRobotConfig, clock: Clock) -> None:
        self._map = config.map
        self._clock = clock
        self._link = ModbusLink(config)
        self._reader = SignalReader(config.map, config.map.signals)

    def open(self) -> None:
        """Connect. `ConnectError` if nobody answers."""
        self._link.connect()

    def read(self) -> list[ShownSignal]:
        """Return all signals in the map's order; raises like `ModbusLink.read`."""
        reading = self._reader.read(self._link, self._clock)
        shown = []
        for name, signal in self._map.signals.items():
            value = self._describe_vector(name, signal, reading) or self._describe(name, signal, reading)
            shown.append(ShownSignal(name, value, _place(signal)))
        return shown

    def close(self) -> None:
        """Close the connection. May be called twice."""
        self._link.close()

    def _describe_vector(self, name: str, signal: Signal, reading: Reading) -> str:
        if not isinstance(signal, VectorSignal):
            return ""
        return " ".join(f"{reading.values[f'{name}.{i}']:.6g}" for i in range(signal.n_values))

    def _describe(self, name: str, signal: Signal, reading: Reading) -> str:
        raw, value = reading.raw[name], reading.values[name]
        if name == "state":
            return f"{raw} ({name_state(self._map, reading)})"
        for interlock in self._map.interlock:
            if name == f"interlock.{interlock.name}":
                return f"{value:g} ({'open' if is_open(interlock.must_be, value) else 'in order'})"
        return f"{value:.10g}" if (signal.scale, signal.offset) == (1.0, 0.0) else f"{value:.6g} (raw {raw:g})"


def _place(signal: Signal) -> str:
    bit = f" bit {signal.bit}" if signal.bit is not None else ""
    return f"{signal.table} {signal.address}{bit} {signal.type}"
