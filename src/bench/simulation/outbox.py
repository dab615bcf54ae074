"""What waits to be sent to one client, over a socket that never blocks."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress

__all__ = ["Outbox"]

REPLY_LIMIT_BYTES = 1_048_576
"""A client that asks this much without reading an answer is cut off."""


class Outbox:
    """Sends at once what the socket takes, keeps the rest of it, and only the newest data package.

    A controller that cannot deliver skips packages and sends the most recent one (RTDE guide), and cuts a client off
    that does not read for about 10 s. Both threads of the simulator send: the scheduler's packages, the network's
    answers.

    Parameters
    ----------
    link : socket
        Non-blocking.
    patience_ns : int
        How long the buffer may stay full.
    """

    def __init__(self, link: socket.socket, patience_ns: int) -> None:
        self._socket = link
        self._patience_ns = patience_ns
        self._lock = threading.Lock()
        self._rest = b""
        self._newest: bytes | None = None
        self._held: bytes | None = None
        self._full_since_ns: int | None = None
        self.is_cut = False
        """The client is gone, or was cut off; the network's thread closes the socket."""
        self.skipped = 0
        """Data packages that were replaced by a newer one."""

    @property
    def is_empty(self) -> bool:
        return not self._rest and self._newest is None

    def send(self, frame: bytes) -> None:
        """Send an answer: never skipped."""
        with self._lock:
            if self._held is not None:
                self._held += frame
                return
            self._rest += frame
            self._flush()
            if len(self._rest) > REPLY_LIMIT_BYTES:
                self._cut()

    def send_package(self, frame: bytes, now_ns: int) -> None:
        """Send a data package, or keep it instead of the one that waits."""
        with self._lock:
            if self._held is not None:
                self._held += frame
                return
            self._flush()
            if not self._rest:
                self._rest = frame
                self._flush()
            else:
                self.skipped += self._newest is not None
                self._newest = frame
            self._watch(now_ns)

    def hold(self) -> None:
        """Keep everything, as a network does that is blocked for a moment, until `release`."""
        with self._lock:
            self._held = self._held or b""

    def release(self) -> None:
        """Send at once all that was held."""
        with self._lock:
            self._rest += self._held or b""
            self._held = None
            self._flush()

    def flush(self, now_ns: int) -> None:
        """Try again to send what waits."""
        with self._lock:
            self._flush()
            self._watch(now_ns)

    def close(self) -> None:
        """Close the socket; nothing is sent any more."""
        with self._lock:
            self.is_cut = True
            self._socket.close()

    def _flush(self) -> None:
        while self._rest and not self.is_cut:
            try:
                n_sent = self._socket.send(self._rest)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                self._cut()
                return
            self._full_since_ns = None
            self._rest = self._rest[n_sent:]
            if not self._rest and self._newest is not None:
                self._rest, self._newest = self._newest, None

    def _watch(self, now_ns: int) -> None:
        if self.is_empty:
            self._full_since_ns = None
        elif self._full_since_ns is None:
            self._full_since_ns = now_ns
        elif now_ns - self._full_since_ns > self._patience_ns:
            self._cut()

    def _cut(self) -> None:
        """Wake the network's thread, which finds the end of the stream and closes the socket."""
        self.is_cut = True
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
