"""RTDE frames and payloads, each both written and read: bytes in, bytes out, no sockets.

The byte order is big-endian throughout. Source: Universal Robots, RTDE guide (protocol versions 1 and 2); checked
against three independent clients.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum

from bench.errors import ProtocolError

__all__ = [
    "IN_USE",
    "NAME_LIST_LIMIT",
    "NOT_FOUND",
    "Frame",
    "FrameSplitter",
    "PackageType",
    "TextMessage",
    "decode_accepted",
    "decode_controller_version",
    "decode_input_setup",
    "decode_output_setup",
    "decode_protocol_version",
    "decode_setup_reply",
    "decode_text",
    "encode_accepted",
    "encode_controller_version",
    "encode_frame",
    "encode_input_setup",
    "encode_output_setup",
    "encode_protocol_version",
    "encode_setup_reply",
    "encode_text",
]

NOT_FOUND = "NOT_FOUND"
"""Stands in the place of a type: the controller does not know this name."""
IN_USE = "IN_USE"
"""Stands in the place of a type: somebody else writes this input."""
NAME_LIST_LIMIT = 2048
"""Longest comma-separated list of names a controller takes, in bytes (RTDE guide)."""

HEADER = struct.Struct(">HB")
RATE = struct.Struct(">d")
PROTOCOL_VERSION = struct.Struct(">H")
CONTROLLER_VERSION = struct.Struct(">4I")
LONGEST_FRAME = 0xFFFF

Frame = tuple[int, bytes]
"""Package type and payload."""


class PackageType(IntEnum):
    """The byte after the size; each is the ASCII code of a letter."""

    PROTOCOL_VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


KNOWN_TYPES = frozenset(int(kind) for kind in PackageType)


def encode_frame(kind: int, payload: bytes = b"") -> bytes:
    """Put the three header bytes before a payload; `ValueError` if it does not fit a 16-bit size."""
    size = HEADER.size + len(payload)
    if size > LONGEST_FRAME:
        raise ValueError(f"a package of {size} bytes exceeds {LONGEST_FRAME}")
    return HEADER.pack(size, kind) + payload


class FrameSplitter:
    """Cuts a byte stream into frames, however the network has split and merged it."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that `data` completes, in order.

        Raises
        ------
        ProtocolError
            At the first header that no RTDE package can have; what follows it is lost.
        """
        if self._rest:
            data = self._rest + data
        frames: list[Frame] = []
        start, end = 0, len(data)
        while end - start >= HEADER.size:
            size, kind = HEADER.unpack_from(data, start)
            if size < HEADER.size or kind not in KNOWN_TYPES:
                raise ProtocolError(
                    f"a header of size {size} and type 0x{kind:02x} arrived, which no RTDE package has.",
                    hint="Check that this port is the controller's RTDE port (30004).",
                )
            if end - start < size:
                break
            frames.append((kind, data[start + HEADER.size : start + size]))
            start += size
        self._rest = data[start:]
        return frames


def encode_protocol_version(version: int) -> bytes:
    """Payload of the request to speak a protocol version."""
    return PROTOCOL_VERSION.pack(version)


def decode_protocol_version(payload: bytes) -> int:
    """Return the protocol version that is asked for."""
    (version,) = _unpack(PROTOCOL_VERSION, payload, "protocol version")
    return int(version)


def encode_accepted(accepted: bool) -> bytes:
    """Payload of the replies to a protocol version, START and PAUSE."""
    return b"\x01" if accepted else b"\x00"


def decode_accepted(payload: bytes) -> bool:
    """Return whether the controller accepts."""
    if len(payload) != 1:
        raise ProtocolError(f"an RTDE reply of {len(payload)} bytes came where 1 byte is due.")
    return payload[0] != 0


def encode_controller_version(version: tuple[int, int, int, int]) -> bytes:
    """Payload that tells the controller's software version: major, minor, bugfix, build."""
    return CONTROLLER_VERSION.pack(*version)


def decode_controller_version(payload: bytes) -> tuple[int, int, int, int]:
    """Return major, minor, bugfix and build of the controller's software."""
    major, minor, bugfix, build = _unpack(CONTROLLER_VERSION, payload, "controller version")
    return major, minor, bugfix, build


def encode_output_setup(names: Iterable[str], rate_hz: float | None) -> bytes:
    """Payload that asks for outputs at a rate; without a rate, as protocol version 1 has it."""
    rate = b"" if rate_hz is None else RATE.pack(rate_hz)
    return rate + ",".join(names).encode()


def decode_output_setup(payload: bytes, protocol: int) -> tuple[float, list[str]]:
    """Return the rate (125 Hz in protocol version 1, which names none) and the names that are asked for."""
    if protocol == 1:
        return 125.0, _split_names(payload)
    if len(payload) < RATE.size:
        raise ProtocolError(f"an RTDE output setup of {len(payload)} bytes holds no rate.")
    return float(RATE.unpack_from(payload)[0]), _split_names(payload[RATE.size :])


def encode_input_setup(names: Iterable[str]) -> bytes:
    """Payload that asks to write inputs."""
    return ",".join(names).encode()


def decode_input_setup(payload: bytes) -> list[str]:
    """Return the names of the inputs that are asked for."""
    return _split_names(payload)


def encode_setup_reply(recipe_id: int | None, types: Sequence[str]) -> bytes:
    """Payload that answers a setup: a type for each name, after the recipe's number (None: outputs in version 1)."""
    head = b"" if recipe_id is None else bytes([recipe_id])
    return head + ",".join(types).encode()


def decode_setup_reply(payload: bytes) -> tuple[int, list[str]]:
    """Return the recipe's number, 0 if it is refused, and a type (or `NOT_FOUND`, `IN_USE`) for each name."""
    if not payload:
        raise ProtocolError("an RTDE setup was answered by an empty package.")
    return payload[0], _split_names(payload[1:])


@dataclass(frozen=True, slots=True)
class TextMessage:
    """A sentence of the controller, or for its log."""

    text: str
    source: str
    level: int
    """0 exception, 1 error, 2 warning, 3 information."""


def encode_text(message: TextMessage) -> bytes:
    """Payload of a text message (protocol version 2). Text and source are cut at 255 bytes."""
    text, source = message.text.encode()[:255], message.source.encode()[:255]
    return bytes([len(text)]) + text + bytes([len(source)]) + source + bytes([message.level])


def decode_text(payload: bytes) -> TextMessage:
    """Return a text message (protocol version 2); bytes that are no UTF-8 are replaced."""
    text, rest = _take_string(payload)
    source, rest = _take_string(rest)
    if len(rest) != 1:
        raise ProtocolError(f"an RTDE text message of {len(payload)} bytes does not end with its level.")
    return TextMessage(text, source, rest[0])


def _take_string(payload: bytes) -> tuple[str, bytes]:
    if not payload or len(payload) <= payload[0]:
        raise ProtocolError(f"an RTDE text message ends after {len(payload)} of the bytes it announces.")
    end = 1 + payload[0]
    return payload[1:end].decode(errors="replace"), payload[end:]


def _split_names(payload: bytes) -> list[str]:
    """Split at commas; one trailing comma is no name (ur_rtde sends it)."""
    text = payload.decode("ascii", errors="replace").removesuffix(",")
    return [name.strip() for name in text.split(",")] if text else []


def _unpack(form: struct.Struct, payload: bytes, what: str) -> tuple[int, ...]:
    if len(payload) != form.size:
        raise ProtocolError(f"an RTDE {what} of {len(payload)} bytes came where {form.size} are due.")
    return form.unpack(payload)
