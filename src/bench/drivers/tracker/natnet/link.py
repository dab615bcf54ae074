"""The UDP sockets to the tracker, and the questions asked before the frames are read."""

from __future__ import annotations

import select
import socket

from bench.config import TrackerConfig
from bench.drivers.flight import FlightRecorder
from bench.drivers.receive import StampedSocket
from bench.drivers.tracker.natnet.networks import open_group_socket
from bench.drivers.tracker.natnet.wire import LARGEST_PACKET, Message, split_packet
from bench.errors import ConnectError
from bench.timing import Clock, patience_ns

__all__ = ["LONGEST_WAIT_S", "CommandLink"]

RECEIVE_BUFFER_BYTES = 4 << 20
"""4 MiB hold 4 s of 360 frames a second with 100 markers, should this process be held up."""
LONGEST_WAIT_S = 0.05
"""How long `receive` waits, machine time; also how late a keepalive or the end of the reader can be."""


class CommandLink:
    """A UDP socket to ask with, to which frames come too in unicast; and one more for those of a multicast."""

    def __init__(self, config: TrackerConfig, clock: Clock, flight: FlightRecorder) -> None:
        self._config = config
        self._flight = flight
        self._clock = clock
        self._socket: socket.socket | None = None
        self._group_socket: socket.socket | None = None
        self._group: tuple[str, int] | None = None
        self._listening: dict[int, StampedSocket] = {}
        self._poll = select.poll()
        self._peer = ("", 0)
        self.local_address = ""
        self.receive_buffer_bytes = 0
        """What the system grants of `RECEIVE_BUFFER_BYTES`; Linux: at most twice net.core.rmem_max."""
        self.stamped_by = ""
        """Who stamps the arrivals; see `bench.drivers.receive`."""

    @property
    def name(self) -> str:
        """Host and port, as the configuration has them."""
        return f"{self._config.host}:{self._config.command_port}"

    @property
    def group(self) -> str:
        """The multicast that is received; empty in unicast."""
        return f"multicast {self._group[0]}:{self._group[1]}" if self._group else ""

    def open(self) -> None:
        """Bind our end. `ConnectError` if the host has no address, or our own address is not ours."""
        self._peer = self._resolve()
        self.local_address = self._config.local_address or self._route()
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            _prepare(link)
            link.bind((self.local_address, 0))
        except OSError as error:
            link.close()
            raise ConnectError(
                f"Our own address {self.local_address} towards the tracker cannot be used: {error.strerror}.",
                hint="Set [tracker] local_address to an address of this machine, or leave it out.",
            ) from error
        self.local_address = str(link.getsockname()[0])
        self.receive_buffer_bytes = link.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        self._socket = link
        self.stamped_by = self._listen(link)

    def follow(self, group: str, port: int) -> None:
        """Receive a multicast too, on the network card of our own address; one that was followed before no longer.

        Raises
        ------
        ConnectError
            It cannot be received.
        """
        if self._socket is None or self._group == (group, port):
            return
        self.unfollow()
        listener = open_group_socket(group, port, self.local_address)
        _prepare(listener)
        self._group, self._group_socket = (group, port), listener
        self._listen(listener)

    def unfollow(self) -> None:
        """Receive what is sent to us alone."""
        self._drop(self._group_socket)
        self._group_socket = self._group = None

    def close(self) -> None:
        self.unfollow()
        self._drop(self._socket)
        self._socket = None

    def _listen(self, link: socket.socket) -> str:
        """Receive from a socket too, and return who stamps what arrives."""
        stamped = StampedSocket(link, self._clock, LARGEST_PACKET)
        self._listening[link.fileno()] = stamped
        self._poll.register(link, select.POLLIN)
        return stamped.stamped_by

    def _drop(self, link: socket.socket | None) -> None:
        if link is not None:
            self._poll.unregister(link)
            del self._listening[link.fileno()]
            link.close()

    def send(self, packet: bytes) -> bool:
        """Send one packet; False if the network refuses it, which the silence that follows will show."""
        if self._socket is None:
            return False
        self._flight.note_sent(packet)
        try:
            self._socket.sendto(packet, self._peer)
        except OSError:
            return False
        return True

    def receive(self, wait_s: float = LONGEST_WAIT_S) -> tuple[bytes, int] | None:
        """Return the next packet of the tracker with its arrival in host time, or None if none came for a while."""
        waiting = self._poll.poll(wait_s * 1000)
        if not waiting:
            return None
        try:
            packet, sender, arrival_ns = self._listening[waiting[0][0]].receive()
        except OSError:
            return None
        if sender[0] != self._peer[0]:
            return None
        self._flight.note_received(packet, arrival_ns)
        return packet, arrival_ns

    def remark(self) -> str:
        """Return a sentence if the kernel left out many stamps; else empty."""
        return next(filter(None, (one.remark() for one in self._listening.values())), "")

    def ask(
        self, question: bytes, answers: tuple[Message, ...], *, tries: int, wait_s: float
    ) -> tuple[int, bytes] | None:
        """Send a question until one of `answers` comes, and return its message number and payload.

        Parameters
        ----------
        tries : int
            How often the question is sent: UDP may lose it, or the answer.
        wait_s : float
            Machine time given to each try.
        """
        for attempt in range(tries):
            self.send(question)
            answer = self._wait_for(answers, wait_s)
            if answer is not None:
                if attempt > 0:  # the answer to the first try may come as well, and must not answer the next question
                    self._wait_for((), wait_s)
                return answer
        return None

    def _wait_for(self, wanted: tuple[Message, ...], wait_s: float) -> tuple[int, bytes] | None:
        deadline_ns = self._clock.now_ns() + patience_ns(self._clock, wait_s)
        while self._clock.now_ns() < deadline_ns:
            received = self.receive()
            if received is None or len(received[0]) < 4:
                continue
            message, payload = split_packet(received[0])
            if message in wanted:
                return message, payload
        return None

    def _resolve(self) -> tuple[str, int]:
        try:
            found = socket.getaddrinfo(self._config.host, self._config.command_port, socket.AF_INET, socket.SOCK_DGRAM)
        except OSError as error:
            raise ConnectError(
                f"The tracker's host '{self._config.host}' has no address: {error.strerror}.",
                hint="Set [tracker] host to the address of the PC that runs Motive.",
            ) from error
        address, port = found[0][4][:2]
        return str(address), int(port)

    def _route(self) -> str:
        """Return our address on the network that leads to the tracker. Nothing is sent."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(self._peer)
            except OSError as error:
                raise ConnectError(
                    f"No network leads to the tracker at {self.name}: {error.strerror}.",
                    hint="Check the cable and the address of this machine on the tracker's network.",
                ) from error
            return str(probe.getsockname()[0])


def _prepare(link: socket.socket) -> None:
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    link.setblocking(False)
