"""The thread that accepts clients, reads what they ask and closes what is over."""

from __future__ import annotations

import selectors
import socket
import struct
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from bench.errors import ConnectError
from bench.simulation.outbox import Outbox

__all__ = ["ServerThread", "Session"]

RECEIVE_BYTES = 65_536
NO_LINGER = struct.pack("ii", 1, 0)
"""SO_LINGER: closing sends RST instead of FIN."""


class Session(Protocol):
    """One client's side of a conversation."""

    def receive(self, data: bytes) -> bool:
        """Take bytes; False to close the connection."""
        ...

    def close(self) -> None: ...


class _NoSession:
    """A client that is accepted and never answered."""

    def receive(self, _data: bytes) -> bool:
        return True

    def close(self) -> None:
        """Nothing was kept."""


@dataclass(frozen=True, slots=True)
class _Listener:
    socket: socket.socket
    welcome: Callable[[Outbox], Session]


@dataclass(frozen=True, slots=True)
class _Client:
    socket: socket.socket
    outbox: Outbox
    session: Session


class ServerThread:
    """Serves any number of ports from one thread.

    Parameters
    ----------
    patience_ns : int
        How long a client may leave its buffer full before it is cut off.
    what : str
        Which simulated device serves, in words.
    """

    def __init__(self, patience_ns: int, what: str = "robot") -> None:
        self._patience_ns = patience_ns
        self._what = what
        self._selector = selectors.DefaultSelector()
        self._wake_receive, self._wake_send = socket.socketpair()
        self._selector.register(self._wake_receive, selectors.EVENT_READ)
        self._thread: threading.Thread | None = None
        self._calls: deque[Callable[[], None]] = deque()
        self._asleep: list[selectors.SelectorKey] = []
        self.is_half_open = False
        """Whether clients that connect from now on are accepted and never answered."""

    def listen(self, host: str, port: int, welcome: Callable[[Outbox], Session]) -> None:
        """Open a port; `welcome` makes the session of each client that connects.

        Raises
        ------
        ConnectError
            The port is taken, or the address is not this machine's.
        """
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
            listener.listen()
        except OSError as error:
            listener.close()
            raise ConnectError(
                f"The simulated {self._what} cannot serve on {host}:{port}, it is already in use or not an address "
                f"of this machine ({error.strerror}).",
                hint="Stop the other program, or choose another loopback address.",
            ) from error
        listener.setblocking(False)
        self._selector.register(listener, selectors.EVENT_READ, _Listener(listener, welcome))

    def start(self) -> None:
        self._thread = threading.Thread(target=self._run, name=f"{self._what}-network", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close all ports and clients and end the thread. May be called twice, and before `start`."""
        if self._wake_send.fileno() == -1:
            return
        self._wake_send.close()
        if self._thread is None:
            self._close_all()
        else:
            self._thread.join()

    def call(self, action: Callable[[], None]) -> None:
        """Run `action` on this thread soon. May be called from any thread; does nothing once closed."""
        self._calls.append(action)
        with suppress(OSError):
            self._wake_send.send(b"!")

    def sleep(self) -> None:
        """Neither accept nor read until `wake`; on this thread (see `call`)."""
        for key in list(self._selector.get_map().values()):
            if key.data is not None:
                self._selector.unregister(key.fileobj)
                self._asleep.append(key)

    def wake(self) -> None:
        """Go on after `sleep`; on this thread."""
        asleep, self._asleep = self._asleep, []
        for key in asleep:
            self._selector.register(key.fileobj, key.events, key.data)

    def drop_clients(self, *, abruptly: bool) -> None:
        """Close every connection, by RST if `abruptly`; on this thread. The ports stay open."""
        was_asleep = bool(self._asleep)
        self.wake()
        for key in list(self._selector.get_map().values()):
            if isinstance(key.data, _Client):
                if abruptly:
                    key.data.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, NO_LINGER)
                self._drop(key.data)
        if was_asleep:
            self.sleep()

    def _run(self) -> None:
        try:
            while self._serve_once():
                pass
        finally:
            self._close_all()

    def _serve_once(self) -> bool:
        for key, _ in self._selector.select():
            if key.data is None:
                if not self._wake_receive.recv(RECEIVE_BYTES):
                    return False
                while self._calls:
                    self._calls.popleft()()
                return True  # what was selected may be gone
            if isinstance(key.data, _Listener):
                self._accept(key.data)
            else:
                self._read(key.data)
        return True

    def _accept(self, listener: _Listener) -> None:
        try:
            link, _ = listener.socket.accept()
        except OSError:
            return
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        outbox = Outbox(link, self._patience_ns)
        client = _Client(link, outbox, _NoSession() if self.is_half_open else listener.welcome(outbox))
        self._selector.register(link, selectors.EVENT_READ, client)

    def _read(self, client: _Client) -> None:
        try:
            data = client.socket.recv(RECEIVE_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if not data or not client.session.receive(data):
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        self._selector.unregister(client.socket)
        client.session.close()
        client.outbox.close()

    def _close_all(self) -> None:
        self.wake()
        for key in list(self._selector.get_map().values()):
            if isinstance(key.data, _Client):
                self._drop(key.data)
            elif isinstance(key.data, _Listener):
                key.data.socket.close()
        self._selector.close()
        self._wake_receive.close()
