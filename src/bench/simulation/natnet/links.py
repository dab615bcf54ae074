"""The simulated tracker's sockets: the command port, what is broadcast to it, and the multicast group."""

from __future__ import annotations

import errno
import select
import socket
import threading
from collections.abc import Callable

from bench.drivers.tracker.natnet.wire import LARGEST_PACKET
from bench.errors import ConnectError
from bench.simulation.natnet.clients import Address

__all__ = ["Links"]

POLL_MS = 20
"""Machine time after which the network thread sees that it should stop."""
JOIN_S = 2.0
MULTICAST_TTL = 1
"""Multicast frames stay in their own network."""


class Links:
    """Serves a command port with a thread of its own, and sends frames to clients or to a group.

    Parameters
    ----------
    address : (str, int)
        Host and command port.
    data_port : int
        Multicast frames come from it, and go to it.
    group : str, optional
        Multicast group; None: unicast alone.
    answer : callable
        Given a packet and its sender, returns what is to be sent back, or None; on the network's thread.
    look_around : callable
        Called by that thread again and again.
    """

    def __init__(
        self,
        address: Address,
        data_port: int,
        group: str | None,
        answer: Callable[[bytes, Address], bytes | None],
        look_around: Callable[[], None],
    ) -> None:
        self._address = address
        self._data_port = data_port
        self._group = None if group is None else (group, data_port)
        self._answer = answer
        self._look_around = look_around
        self._command: socket.socket | None = None
        self._data: socket.socket | None = None
        self._broadcast: socket.socket | None = None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Bind the ports and answer from now on.

        Raises
        ------
        ConnectError
            An address is in use, or not ours.
        """
        host, port = self._address
        self._command = _bind(host, port)
        try:
            if self._group is not None:
                self._data = self._open_group(host)
            self._broadcast = _bind_broadcast(*self.address)
        except BaseException:
            self._close_sockets()
            raise
        self._thread = threading.Thread(target=self._serve, name="natnet-server", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering and sending. May be called twice."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(JOIN_S)
        self._close_sockets()

    @property
    def address(self) -> Address:
        """Host and command port; with port 0 the one that the system chose."""
        if self._command is None:
            return self._address
        host, port = self._command.getsockname()[:2]
        return str(host), int(port)

    def send(self, packet: bytes, address: Address) -> bool:
        """Send from the command port; False if the network does not take it, or is closed."""
        return self._send(self._command, packet, address)

    def send_to_group(self, packet: bytes) -> bool:
        """Send from the data port to the group; False if the network does not take it, or is closed."""
        return self._group is not None and self._send(self._data, packet, self._group)

    def _send(self, link: socket.socket | None, packet: bytes, address: Address) -> bool:
        if link is None or self._stopping.is_set():
            return False
        try:
            link.sendto(packet, address)
        except OSError:
            return False
        return True

    def _open_group(self, host: str) -> socket.socket:
        # Shared: a client on this computer listens on the same port.
        link = _bind(host, self._data_port, shared=True)
        link.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(host))
        link.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, MULTICAST_TTL)
        link.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        return link

    def _close_sockets(self) -> None:
        for link in (self._command, self._data, self._broadcast):
            if link is not None:
                link.close()
        self._command = self._data = self._broadcast = None

    def _serve(self) -> None:
        poll = select.poll()
        links = {link.fileno(): link for link in (self._command, self._broadcast) if link is not None}
        for number in links:
            poll.register(number, select.POLLIN)
        while not self._stopping.is_set():
            for number, _ in poll.poll(POLL_MS):
                self._answer_one(links[number])
            self._look_around()

    def _answer_one(self, link: socket.socket) -> None:
        try:
            packet, sender = link.recvfrom(LARGEST_PACKET)
        except OSError:
            return
        reply = self._answer(packet, sender)
        if reply is not None:
            self.send(reply, sender)


def _bind(host: str, port: int, *, shared: bool = False) -> socket.socket:
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if shared:
            link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        link.bind((host, port))
    except OSError as error:
        link.close()
        reason = "is already in use" if error.errno == errno.EADDRINUSE else f"cannot be used: {error.strerror}"
        raise ConnectError(f"UDP port {host}:{port} of the simulated tracker {reason}.") from error
    link.setblocking(False)
    return link


def _bind_broadcast(host: str, port: int) -> socket.socket:
    """Hear what is sent to everyone in the host's network of 256 addresses, as discoveries are."""
    return _bind(f"{host.rpartition('.')[0]}.255", port, shared=True)
