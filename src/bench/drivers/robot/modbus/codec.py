"""Modbus registers to values and back, as pure functions.

A register is 16 bits. Longer values take several, in either word order; and some controllers swap the two bytes of
each register. Modbus itself says nothing about values longer than a register.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

__all__ = ["decode", "encode", "wrap_to_type"]

FORMATS = {"i16": ">h", "u16": ">H", "i32": ">i", "u32": ">I", "i64": ">q", "f32": ">f", "f64": ">d"}


def decode(kind: str, registers: Sequence[int], *, word_order: str = "big", byte_order: str = "big") -> int | float:
    """Return the value that the registers hold.

    Parameters
    ----------
    kind : str
        `i16`, `u16`, `i32`, `u32`, `i64`, `f32` or `f64`.
    registers : sequence of int
        As many as the kind takes, in order of address.
    word_order, byte_order : str
        `big`: the high word, or byte, comes first.
    """
    words = list(registers) if word_order == "big" else list(reversed(registers))
    code = ">" if byte_order == "big" else "<"
    value: int | float = struct.unpack(FORMATS[kind], struct.pack(f"{code}{len(words)}H", *words))[0]
    return value


def encode(kind: str, value: float, *, word_order: str = "big", byte_order: str = "big") -> list[int]:
    """Return the registers that hold `value`, in order of address; the inverse of `decode`.

    Raises
    ------
    ValueError
        The value does not fit the kind.
    """
    try:
        packed = struct.pack(FORMATS[kind], value if kind[0] == "f" else int(value))
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{value:g} does not fit a {kind}") from error
    code = ">" if byte_order == "big" else "<"
    words = list(struct.unpack(f"{code}{len(packed) // 2}H", packed))
    return words if word_order == "big" else words[::-1]


def wrap_to_type(kind: str, value: int) -> int:
    """Return what a whole-number counter of this kind holds after counting to `value`: it starts again at its end."""
    n_bits = 1 if kind == "bool" else int(kind[1:])
    wrapped = value % (1 << n_bits)
    return wrapped - (1 << n_bits) if kind[0] == "i" and wrapped >= 1 << (n_bits - 1) else wrapped
