"""The four Modbus tables of a simulated controller, and the values of a register map in them."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from pymodbus.client.mixin import ModbusClientMixin

from bench.config import RegisterMap, Signal, VectorSignal

__all__ = ["TABLES", "Tables"]

TABLES = ("coil", "discrete", "holding", "input")
SPARE = 8
"""Addresses that exist beyond the last one in use; a read further on is refused."""
DATATYPES = {
    "i16": ModbusClientMixin.DATATYPE.INT16,
    "u16": ModbusClientMixin.DATATYPE.UINT16,
    "i32": ModbusClientMixin.DATATYPE.INT32,
    "u32": ModbusClientMixin.DATATYPE.UINT32,
    "i64": ModbusClientMixin.DATATYPE.INT64,
    "f32": ModbusClientMixin.DATATYPE.FLOAT32,
    "f64": ModbusClientMixin.DATATYPE.FLOAT64,
}


class Tables:
    """Memory of a simulated controller: written by its scan and by clients, from any thread.

    Values are put into registers by pymodbus, so that the driver's own way of reading them is checked against it.
    """

    def __init__(self, register_map: RegisterMap) -> None:
        self._map = register_map
        self._lock = threading.RLock()
        self._cells = {table: [0] * self._size(table) for table in TABLES}

    def _size(self, table: str) -> int:
        signals = [signal for signal in self._map.signals.values() if signal.table == table]
        return max((signal.address - self._map.base + signal.span for signal in signals), default=0) + SPARE

    @contextmanager
    def scan(self) -> Iterator[None]:
        """Let nobody read between the writes of one scan."""
        with self._lock:
            yield

    def size(self, table: str) -> int:
        """Return how many addresses a table has."""
        return len(self._cells[table])

    def clear(self) -> None:
        """Write 0 everywhere, as after power-up."""
        with self._lock:
            self._cells = {table: [0] * len(cells) for table, cells in self._cells.items()}

    def read_cells(self, table: str) -> list[int]:
        """Return a whole table: registers, or bits as 0 and 1."""
        with self._lock:
            return list(self._cells[table])

    def write_cells(self, table: str, first: int, values: Sequence[int]) -> None:
        """Write a row of registers or bits, address counted from 0."""
        with self._lock:
            self._cells[table][first : first + len(values)] = [int(value) for value in values]

    def set(self, signal: Signal, value: float, index: int = 0) -> None:
        """Give a signal, or one value of a vector, its scaled value."""
        raw = (value - signal.offset) / signal.scale
        first = self._first(signal, index)
        if signal.in_bits:
            self.write_cells(signal.table, first, [int(raw != 0)])
        elif signal.bit is not None:
            with self._lock:
                self._cells[signal.table][first] = _with_bit(self._cells[signal.table][first], self._bit(signal), raw)
        else:
            self.write_cells(signal.table, first, self._to_registers(signal, raw))

    def get(self, signal: Signal) -> float:
        """Return the scaled value of a signal."""
        first = self._first(signal, 0)
        with self._lock:
            cells = self._cells[signal.table][first : first + signal.width]
        if signal.in_bits:
            return cells[0] * signal.scale + signal.offset
        if signal.bit is not None:
            return (cells[0] >> self._bit(signal) & 1) * signal.scale + signal.offset
        registers = self._swap_bytes(signal, cells)
        word_order = signal.word_order or self._map.word_order
        raw = ModbusClientMixin.convert_from_registers(registers, DATATYPES[signal.type], word_order)
        return float(raw) * signal.scale + signal.offset  # type: ignore[arg-type]  # a number, for these types

    def _first(self, signal: Signal, index: int) -> int:
        step = signal.step if isinstance(signal, VectorSignal) else 0
        return signal.address - self._map.base + index * step

    def _bit(self, signal: Signal) -> int:
        swapped = (signal.byte_order or self._map.byte_order) == "little"
        return (signal.bit or 0) ^ (8 if swapped else 0)

    def _to_registers(self, signal: Signal, raw: float) -> list[int]:
        word_order = signal.word_order or self._map.word_order
        value = raw if signal.type.startswith("f") else _fit(signal.type, round(raw))
        registers = ModbusClientMixin.convert_to_registers(value, DATATYPES[signal.type], word_order)
        return self._swap_bytes(signal, registers)

    def _swap_bytes(self, signal: Signal, registers: Sequence[int]) -> list[int]:
        if (signal.byte_order or self._map.byte_order) == "big":
            return list(registers)
        return [(register & 0xFF) << 8 | register >> 8 for register in registers]


def _with_bit(register: int, bit: int, raw: float) -> int:
    return register | 1 << bit if raw else register & ~(1 << bit)


def _fit(kind: str, value: int) -> int:
    """Wrap a whole number as a controller's register does."""
    n_bits = int(kind[1:])
    wrapped = value % (1 << n_bits)
    return wrapped - (1 << n_bits) if kind[0] == "i" and wrapped >= 1 << (n_bits - 1) else wrapped
