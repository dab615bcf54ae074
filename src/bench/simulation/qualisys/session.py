"""One client's conversation with QTM: commands in words, answers in packets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from bench.simulation.outbox import Outbox
from bench.simulation.qualisys.packets import COMPONENTS, HEADER, PacketType, encode

__all__ = ["QtmSession", "Source"]

OLDEST, NEWEST = (1, 8), (1, 25)
"""Versions of the protocol that the simulated QTM speaks; the newest is of 2024."""
FIRST_VERSION = "1.1"
"""Until the client says which it wants."""
LONGEST_COMMAND = 10_000
CAPTURE_STARTED = b"\x03"
SAYINGS = {"qtmversion": "QTM Version is 2024.2 (build 16000)", "byteorder": "Byte order is little endian"}


class Source(Protocol):
    """What the conversations of all clients share."""

    rate_hz: float

    def settings(self, version: str) -> bytes:
        """Return the packet with the settings."""
        ...

    def newest(self, wanted: tuple[int, ...]) -> bytes:
        """Return the packet of the newest frame."""
        ...


class QtmSession:
    """Answers one client; `wanted` says what of each frame it is to be sent.

    Parameters
    ----------
    outbox : Outbox
    source : Source
    on_close : callable
        Called with the session when the client is gone.
    """

    def __init__(self, outbox: Outbox, source: Source, on_close: Callable[[QtmSession], None]) -> None:
        self.outbox = outbox
        self.wanted: tuple[int, ...] = ()
        """Types of the components to stream; none: nothing is streamed."""
        self.divisor = 1
        """Every n-th frame is streamed."""
        self._source = source
        self._on_close = on_close
        self._version = FIRST_VERSION
        self._waiting = b""
        self._say("QTM RT Interface connected")

    def receive(self, data: bytes) -> bool:
        """Take bytes and answer every command that is complete; False to close the connection."""
        self._waiting += data
        while len(self._waiting) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._waiting)
            if not HEADER.size <= size <= LONGEST_COMMAND:
                return False
            if len(self._waiting) < size:
                break
            content, self._waiting = self._waiting[HEADER.size : size], self._waiting[size:]
            words = content.rstrip(b"\0").decode("ascii", errors="replace").lower().split()
            if kind == PacketType.COMMAND and not self._obey(words):
                return False
        return True

    def close(self) -> None:
        """Forget the client."""
        self._on_close(self)

    def _obey(self, words: list[str]) -> bool:
        command, arguments = (words[0], words[1:]) if words else ("", [])
        if command == "quit":
            self._say("Bye bye")
            return False
        if command in SAYINGS:
            self._say(SAYINGS[command])
        elif command == "getstate":
            self._send(PacketType.EVENT, CAPTURE_STARTED)
        elif command == "getparameters":
            self.outbox.send(self._source.settings(self._version))
        else:
            self._obey_with_arguments(command, arguments)
        return True

    def _obey_with_arguments(self, command: str, arguments: list[str]) -> None:
        if command == "version":
            self._set_version(arguments)
        elif command == "getcurrentframe":
            self._send_newest(arguments)
        elif command == "streamframes":
            self._stream(arguments)
        else:
            self._refuse("Parse error")

    def _set_version(self, words: list[str]) -> None:
        if not words:
            self._say(f"Version is {self._version}")
            return
        try:
            major, minor = (int(part) for part in words[0].split("."))
        except ValueError:
            self._refuse("Parse error")
            return
        if not OLDEST <= (major, minor) <= NEWEST:
            self._refuse("Version NOT supported")
            return
        self._version = words[0]
        self._say(f"Version set to {words[0]}")

    def _send_newest(self, words: list[str]) -> None:
        wanted = _components(words)
        if wanted:
            self.outbox.send(self._source.newest(wanted))
        else:
            self._refuse("Parse error")

    def _stream(self, words: list[str]) -> None:
        if words == ["stop"]:
            self.wanted = ()
            return
        divisor, wanted = self._divisor(words[0] if words else ""), _components(words[1:])
        if divisor is None or not wanted:
            self._refuse("Parse error")
            return
        self.divisor, self.wanted = divisor, wanted

    def _divisor(self, word: str) -> int | None:
        name, _, number = word.partition(":")
        if name == "allframes" and not number:
            return 1
        if not number.isdigit() or int(number) == 0:
            return None
        if name == "frequencydivisor":
            return int(number)
        return max(1, round(self._source.rate_hz / int(number))) if name == "frequency" else None

    def _say(self, text: str) -> None:
        self._send(PacketType.COMMAND, text.encode() + b"\0")

    def _refuse(self, text: str) -> None:
        self._send(PacketType.ERROR, text.encode() + b"\0")

    def _send(self, kind: int, content: bytes) -> None:
        self.outbox.send(encode(kind, content))


def _components(words: list[str]) -> tuple[int, ...]:
    """Return the types of the named components; none if one of them cannot be sent."""
    known = tuple(COMPONENTS[word] for word in words if word in COMPONENTS)
    return known if len(known) == len(words) else ()
