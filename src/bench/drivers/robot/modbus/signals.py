"""Reads and writes the signals of a register map: addresses, types and orders are dealt with here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from bench.config import RegisterMap, Signal, VectorSignal
from bench.drivers.robot.modbus.blocks import Block, plan_blocks
from bench.drivers.robot.modbus.codec import decode, encode
from bench.drivers.robot.modbus.link import ModbusLink
from bench.errors import ConfigError
from bench.timing import Clock

__all__ = ["Reading", "SignalReader", "decode_signal", "encode_signal", "scaled", "write_signal"]

Image = Mapping[tuple[str, int], int]
"""What stands at (table, address), address counted from 0."""


@dataclass(frozen=True, slots=True)
class Reading:
    """All signals of one poll."""

    before_ns: int
    """Host time just before the first request."""
    after_ns: int
    """Host time just after the last answer."""
    raw: dict[str, int | float]
    """Value of each signal as the controller gives it, by name; of a vector by `name.0`, `name.1` …"""
    values: dict[str, float]
    """The same scaled."""


class SignalReader:
    """Reads a set of signals with as few requests as possible.

    Parameters
    ----------
    register_map : RegisterMap
        Addressing and orders.
    signals : mapping of str to Signal
        What to read.
    """

    def __init__(self, register_map: RegisterMap, signals: Mapping[str, Signal]) -> None:
        self._map = register_map
        self._single = dict(_single_values(signals))
        base = register_map.base
        spans = [(signal.table, address - base, signal.width) for signal, address in self._single.values()]
        self.blocks: list[Block] = plan_blocks(spans, register_map.read_gap, register_map.read_max)
        """The requests of one poll."""

    def read(self, link: ModbusLink, clock: Clock) -> Reading:
        """Read all signals once; raises like `ModbusLink.read`."""
        before_ns = clock.now_ns()
        image: dict[tuple[str, int], int] = {}
        for block in self.blocks:
            for i, value in enumerate(link.read(block)):
                image[block.table, block.address + i] = value
        after_ns = clock.now_ns()
        raw = {name: decode_signal(signal, self._map, image, at) for name, (signal, at) in self._single.items()}
        values = {name: scaled(self._single[name][0], value) for name, value in raw.items()}
        return Reading(before_ns, after_ns, raw, values)


def decode_signal(signal: Signal, register_map: RegisterMap, image: Image, address: int) -> int | float:
    """Return the raw value of a signal whose (first) address, counted as in the map, is `address`."""
    first = address - register_map.base
    if signal.in_bits:
        return image[signal.table, first]
    registers = [image[signal.table, first + i] for i in range(signal.width)]
    byte_order = signal.byte_order or register_map.byte_order
    if signal.bit is not None:
        return int(decode("u16", registers, byte_order=byte_order)) >> signal.bit & 1
    word_order = signal.word_order or register_map.word_order
    return decode(signal.type, registers, word_order=word_order, byte_order=byte_order)


def scaled(signal: Signal, raw: float) -> float:
    """Return scale * raw + offset."""
    return raw * signal.scale + signal.offset


def encode_signal(signal: Signal, register_map: RegisterMap, value: float) -> list[int]:
    """Return what must be written so that the signal has this (scaled) value.

    Raises
    ------
    ConfigError
        The value does not fit the signal's type.
    """
    raw = (value - signal.offset) / signal.scale
    if signal.in_bits:
        return [int(raw != 0)]
    raw = raw if signal.type.startswith("f") else round(raw)
    try:
        return encode(
            signal.type,
            raw,
            word_order=signal.word_order or register_map.word_order,
            byte_order=signal.byte_order or register_map.byte_order,
        )
    except ValueError as error:
        raise ConfigError(
            f"{value:g} cannot be written to {signal.table} {signal.address}: {error}.", hint="Use a wider type there."
        ) from error


def write_signal(link: ModbusLink, register_map: RegisterMap, signal: Signal, value: float) -> None:
    """Write one signal by one request; raises like `ModbusLink.write`."""
    link.write(signal.table, signal.address - register_map.base, encode_signal(signal, register_map, value))


def _single_values(signals: Mapping[str, Signal]) -> Iterator[tuple[str, tuple[Signal, int]]]:
    for name, signal in signals.items():
        if isinstance(signal, VectorSignal):
            yield from ((f"{name}.{i}", (signal, signal.address + i * signal.step)) for i in range(signal.n_values))
        else:
            yield name, (signal, signal.address)
