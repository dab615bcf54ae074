"""What all NatNet packets share: the header, the message numbers and a cursor that never reads past the end.

NatNet is UDP, little endian and packed. Sources: the manual in OptiTrack/OptiTrack-User-Docs-Motive, and the recorded
packets of a real Motive 2.1 that the tests decode.
"""

from __future__ import annotations

from enum import IntEnum
from struct import Struct
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.errors import ProtocolError

__all__ = [
    "HEADER",
    "LARGEST_PACKET",
    "LARGEST_TICKS",
    "Message",
    "Reader",
    "Version",
    "dotted",
    "encode_packet",
    "pack_text",
    "split_packet",
    "verify_whole",
]

Version = tuple[int, ...]
"""A NatNet or application version, most significant number first; compares as versions do."""

HEADER = Struct("<HH")
"""Message number, bytes of payload."""
COUNT = Struct("<i")
count_at = COUNT.unpack_from
"""A frame has a dozen counts: looking the method up each time is a third of reading one."""
LARGEST_PACKET = 65_507
"""The most a UDP datagram carries over IPv4."""
LARGEST_TICKS = 2**63 - 1
"""The most a run file holds. A counter of 10 MHz gets there in 29 000 years, a corrupted one at once."""


class Message(IntEnum):
    """Message numbers of the header."""

    CONNECT = 0
    SERVERINFO = 1
    REQUEST = 2
    RESPONSE = 3
    REQUEST_MODELDEF = 4
    MODELDEF = 5
    REQUEST_FRAMEOFDATA = 6
    FRAMEOFDATA = 7
    MESSAGESTRING = 8
    DISCONNECT = 9
    KEEPALIVE = 10
    DISCONNECTBYTIMEOUT = 11
    ECHOREQUEST = 12
    ECHORESPONSE = 13
    DISCOVERY = 14
    UNRECOGNIZED_REQUEST = 100
    """Decimal 100, as Motive really sends it (published clients disagree)."""


def encode_packet(message: Message, payload: bytes = b"") -> bytes:
    """Put the header before a payload."""
    if len(payload) > LARGEST_PACKET - HEADER.size:
        raise ProtocolError(
            f"A NatNet {message.name} of {len(payload)} bytes does not fit one packet of {LARGEST_PACKET} bytes."
        )
    return HEADER.pack(message, len(payload)) + payload


def split_packet(packet: bytes) -> tuple[int, bytes]:
    """Return message number and payload.

    The payload is whatever was received: clients in the field send header sizes that are wrong by one, or 0.

    Raises
    ------
    ProtocolError
        Shorter than a header.
    """
    if len(packet) < HEADER.size:
        raise ProtocolError(
            f"A NatNet packet of {len(packet)} bytes is shorter than its header of {HEADER.size} bytes."
        )
    return HEADER.unpack_from(packet)[0], packet[HEADER.size :]


def verify_whole(packet: bytes) -> None:
    """Check that a server's packet has all the bytes that its header announces.

    Raises
    ------
    ProtocolError
        It has fewer. Not for packets of clients, whose sizes mean little.
    """
    announced = HEADER.unpack_from(packet)[1] + HEADER.size
    if announced > len(packet):
        raise ProtocolError(f"A NatNet packet of {len(packet)} bytes was cut: its header announces {announced}.")


def dotted(version: Version) -> str:
    """Write a version without its trailing zeros, but with two numbers."""
    numbers = list(version)
    while len(numbers) > 2 and numbers[-1] == 0:
        numbers.pop()
    return ".".join(map(str, numbers))


def pack_text(text: str) -> bytes:
    """Encode a zero-terminated string."""
    return text.encode("utf-8", "surrogateescape") + b"\0"


class Reader:
    """A cursor over one payload; whatever would reach past its end is a `ProtocolError`."""

    __slots__ = ("data", "end", "offset", "what")

    def __init__(self, data: bytes, what: str, offset: int = 0, end: int | None = None) -> None:
        self.data = data
        self.what = what
        self.offset = offset
        self.end = len(data) if end is None else end

    @property
    def remaining(self) -> int:
        """Bytes not read yet."""
        return self.end - self.offset

    def advance(self, n_bytes: int) -> int:
        """Move on by `n_bytes` and return where they begin."""
        start = self.offset
        if n_bytes < 0 or start + n_bytes > self.end:
            raise ProtocolError(
                f"A NatNet {self.what} ends early: {n_bytes} bytes are due at byte {start} of {self.end}."
            )
        self.offset = start + n_bytes
        return start

    def take(self, n_bytes: int) -> bytes:
        start = self.advance(n_bytes)
        return self.data[start : self.offset]

    def unpack(self, layout: Struct) -> tuple[Any, ...]:
        return layout.unpack_from(self.data, self.advance(layout.size))

    def integer(self) -> int:
        """Read a signed 32-bit number."""
        n: int = count_at(self.data, self.advance(4))[0]
        return n

    def count(self, item_bytes: int) -> int:
        """Read how many items follow, of at least `item_bytes` each; more than the packet can hold is refused."""
        start = self.offset
        if start + 4 > self.end:
            self.advance(4)
        n: int = count_at(self.data, start)[0]
        self.offset = start = start + 4
        if n < 0 or n * item_bytes > self.end - start:
            raise ProtocolError(
                f"A NatNet {self.what} announces {n} items of {item_bytes} bytes where {self.remaining} bytes are left."
            )
        return n

    def array(self, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
        """Read how many items follow, and the items, without copying them."""
        item_bytes = dtype.itemsize
        n = self.count(item_bytes)
        start = self.offset
        self.offset = start + n * item_bytes
        return np.frombuffer(self.data, dtype, n, start)

    def text(self) -> str:
        """Read a zero-terminated string."""
        stop = self.data.find(b"\0", self.offset, self.end)
        if stop < 0:
            raise ProtocolError(f"A NatNet {self.what} holds a string without its end at byte {self.offset}.")
        raw = self.data[self.offset : stop]
        self.offset = stop + 1
        return raw.decode("utf-8", "surrogateescape")
