"""CDR as ROS 2 writes it (XCDR1, little-endian), derived from message definitions.

Two ways through the same layout: value by value for what holds strings, and whole arrays at once for what has
always the same size. `Layout` is the second: it takes one encoded example and notes where each number stands.

References
----------
OMG Common Data Representation, version 1: a value is aligned to its own size, counted from the byte after the
4-byte header; a string is its length with the closing NUL, the bytes, the NUL.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bench.recording.messages.schemas import PRIMITIVES, Field, Schema

__all__ = ["HEADER", "CdrError", "Layout", "Leaf", "decode", "encode"]

HEADER = b"\x00\x01\x00\x00"
"""CDR, little-endian, no options."""


class CdrError(ValueError):
    """Bytes that are not what their message definition says. Callers turn it into a `RecordingError`."""


@dataclass(frozen=True, slots=True)
class Leaf:
    """One number, or array of numbers, of an encoded message."""

    path: str
    """Dotted names; items of a sequence by their index."""
    offset: int
    """Bytes from the start of the message, its header included."""
    code: str
    """`struct` code."""
    count: int | None
    """None for a single value."""


def encode(schema: Schema, values: Mapping[str, Any]) -> bytes:
    """Encode nested `values`; what is left out is zero, empty or false."""
    out = bytearray(HEADER)
    _encode_fields(schema, schema.fields, values, out)
    return bytes(out)


def decode(schema: Schema, data: bytes | memoryview, leaves: list[Leaf] | None = None) -> dict[str, Any]:
    """Decode one message into values by dotted path (arrays of numbers as tuples, ``uint8[]`` as bytes).

    Raises
    ------
    CdrError
        The message is shorter than its own lengths say, or has another header.
    """
    if bytes(data[:4]) != HEADER:
        raise CdrError(f"{schema.name}: header {bytes(data[:4]).hex()} is not little-endian CDR")
    cursor = _Cursor(data, leaves)
    values: dict[str, Any] = {}
    _decode_fields(schema, schema.fields, "", cursor, values)
    return values


@dataclass(frozen=True)
class Layout:
    """Where each number of a message stands, for messages that are all alike but for their numbers."""

    size: int
    """Bytes of a message, its header included."""
    leaves: tuple[Leaf, ...]

    @classmethod
    def of(cls, schema: Schema, example: bytes | None = None) -> Layout:
        """Note the layout of `example`; without one, of the message whose numbers are all zero."""
        data = encode(schema, {}) if example is None else example
        leaves: list[Leaf] = []
        decode(schema, data, leaves)
        return cls(len(data), tuple(leaves))

    @cached_property
    def packer(self) -> struct.Struct:
        """Packs the header's 4 bytes, then every number in order, with the padding between them."""
        text, position = "<4s", len(HEADER)
        for leaf in self.leaves:
            text += f"{leaf.offset - position}x{1 if leaf.count is None else leaf.count}{leaf.code}"
            position = leaf.offset + (1 if leaf.count is None else leaf.count) * struct.calcsize("<" + leaf.code)
        return struct.Struct(text)

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """The whole message as a numpy record, fields named by path."""
        formats = [_numpy_format(leaf) for leaf in self.leaves]
        return np.dtype(
            {
                "names": [leaf.path for leaf in self.leaves],
                "formats": formats,
                "offsets": [leaf.offset for leaf in self.leaves],
                "itemsize": self.size,
            }
        )

    def offset_of(self, path: str) -> int:
        """Return where a number stands; `CdrError` if there is none of that path."""
        for leaf in self.leaves:
            if leaf.path == path:
                return leaf.offset
        raise CdrError(f"there is no number '{path}' in the message")


def _numpy_format(leaf: Leaf) -> Any:
    # a bool is read as a byte: a damaged 2 must not become an invalid numpy bool
    base = np.dtype("u1" if leaf.code == "?" else "<" + leaf.code)
    return base if leaf.count is None else (base, (leaf.count,))


def _pad(out: bytearray, size: int) -> None:
    out.extend(bytes(-(len(out) - len(HEADER)) % size))


def _encode_fields(schema: Schema, fields: Sequence[Field], values: Mapping[str, Any], out: bytearray) -> None:
    for field in fields:
        value = values.get(field.name)
        if field.length is None:
            _encode_one(schema, field.type, value, out)
            continue
        items = value if value is not None else (None,) * max(field.length, 0)
        if field.length == -1:
            _pad(out, 4)
            out += struct.pack("<I", len(items))
        if isinstance(items, bytes) and field.type == "uint8":
            out += items
            continue
        _encode_items(schema, field.type, items, out)


def _encode_items(schema: Schema, kind: str, items: Sequence[Any], out: bytearray) -> None:
    code, names = _numbers_in(schema, kind)
    if not code:
        for item in items:
            _encode_one(schema, kind, item, out)
    elif len(items):  # numbers of one size stand side by side: packed at once they cost a sixth
        numbers = [(item or {}).get(name) for item in items for name in names] if names else items
        _pad(out, struct.calcsize("<" + code))
        out += struct.pack(f"<{len(numbers)}{code}", *(0 if number is None else number for number in numbers))


def _numbers_in(schema: Schema, kind: str) -> tuple[str, list[str]]:
    """Return the `struct` code of a number, or of all fields, and their names, of a point, a colour; "" for others."""
    if kind in PRIMITIVES:
        return PRIMITIVES[kind], []
    fields = schema.types.get(kind, ())
    codes = {PRIMITIVES.get(field.type, "") if field.length is None else "" for field in fields}
    return (codes.pop(), [field.name for field in fields]) if len(codes) == 1 else ("", [])


def _encode_one(schema: Schema, kind: str, value: Any, out: bytearray) -> None:
    if kind == "string":
        raw = (value or "").encode("utf-8", "replace").replace(b"\0", b" ") + b"\0"
        _pad(out, 4)
        out += struct.pack("<I", len(raw)) + raw
    elif kind in PRIMITIVES:
        code = "<" + PRIMITIVES[kind]
        _pad(out, struct.calcsize(code))
        out += struct.pack(code, 0 if value is None else value)
    else:
        _encode_fields(schema, schema.types[kind], value or {}, out)


class _Cursor:
    """A place in a message that never goes beyond its end."""

    def __init__(self, data: bytes | memoryview, leaves: list[Leaf] | None) -> None:
        self.data = memoryview(data)
        self.offset = len(HEADER)
        self.leaves = leaves

    def take(self, size: int, alignment: int = 1) -> memoryview:
        start = self.offset + -(self.offset - len(HEADER)) % alignment
        if start + size > len(self.data):
            raise CdrError(f"{size} bytes at {start} of a message of {len(self.data)}")
        self.offset = start + size
        return self.data[start : self.offset]

    def numbers(self, path: str, code: str, count: int | None) -> Any:
        size = struct.calcsize("<" + code)
        raw = self.take(size * (1 if count is None else count), size if count != 0 else 1)
        if self.leaves is not None:
            self.leaves.append(Leaf(path, self.offset - len(raw), code, count))
        if count is None:
            return struct.unpack("<" + code, raw)[0]
        return bytes(raw) if code == "B" else struct.unpack(f"<{count}{code}", raw)

    def length(self) -> int:
        return int(struct.unpack("<I", self.take(4, 4))[0])

    def string(self) -> str:
        return bytes(self.take(self.length())).rstrip(b"\0").decode("utf-8", "replace")


def _decode_fields(schema: Schema, fields: Sequence[Field], prefix: str, cursor: _Cursor, out: dict[str, Any]) -> None:
    for field in fields:
        path = prefix + field.name
        count = cursor.length() if field.length == -1 else field.length
        if field.type in PRIMITIVES:
            if field.length == -1 and cursor.leaves is not None:
                cursor.leaves.append(Leaf(path + ".length", cursor.offset - 4, "I", None))
            out[path] = cursor.numbers(path, PRIMITIVES[field.type], count)
        elif count is None:
            _decode_one(schema, field.type, path, cursor, out)
        else:
            for i in range(_bounded(count, cursor)):
                _decode_one(schema, field.type, f"{path}.{i}", cursor, out)


def _decode_one(schema: Schema, kind: str, path: str, cursor: _Cursor, out: dict[str, Any]) -> None:
    if kind == "string":
        out[path] = cursor.string()
    else:
        _decode_fields(schema, schema.types[kind], path + ".", cursor, out)


def _bounded(count: int, cursor: _Cursor) -> int:
    """Refuse a count that the rest of the message cannot hold, each item taking a byte at least."""
    if count > len(cursor.data) - cursor.offset:
        raise CdrError(f"{count} items in the {len(cursor.data) - cursor.offset} bytes left of a message")
    return count
