"""The thread that accepts clients, reads what they ask and closes what is over."""

from __future__ import annotations

import selectors
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from bench.errors import ConnectError
from bench.simulation.ur.outbox import Outbox

__all__ = ["ServerThread", "Session"]

RECEIVE_BYTES = 65_536


class Session(Protocol):
    """One client's side of a conversation."""

    def receive(self, data: bytes) -> bool:
        """Take bytes; False to close the connection."""
        ...

    def close(self) -> None: ...


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
    """

    def __init__(self, patience_ns: int) -> None:
        self._patience_ns = patience_ns
        self._selector = selectors.DefaultSelector()
        self._wake_receive, self._wake_send = socket.socketpair()
        self._selector.register(self._wake_receive, selectors.EVENT_READ)
        self._thread: threading.Thread | None = None

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
                f"The simulated robot cannot serve on {host}:{port}, it is already in use or not an address of this "
                f"machine ({error.strerror}).",
                hint="Stop the other program, or choose another loopback address.",
            ) from error
        listener.setblocking(False)
        self._selector.register(listener, selectors.EVENT_READ, _Listener(listener, welcome))

    def start(self) -> None:
        self._thread = threading.Thread(target=self._run, name="ur-network", daemon=True)
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

    def _run(self) -> None:
        try:
            while self._serve_once():
                pass
        finally:
            self._close_all()

    def _serve_once(self) -> bool:
        for key, _ in self._selector.select():
            if key.data is None:
                return False
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
        client = _Client(link, outbox, listener.welcome(outbox))
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
        for key in list(self._selector.get_map().values()):
            if isinstance(key.data, _Client):
                self._drop(key.data)
            elif isinstance(key.data, _Listener):
                key.data.socket.close()
        self._selector.close()
        self._wake_receive.close()
