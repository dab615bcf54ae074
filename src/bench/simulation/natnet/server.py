"""A tracker on the wire: exposures at exact periods of its own clock, frames to every unicast client."""

from __future__ import annotations

import errno
import select
import socket
import threading
from functools import partial

import numpy as np

from bench.drivers.tracker.natnet.frame import Frame, encode_frame
from bench.drivers.tracker.natnet.messages import ServerInfo
from bench.drivers.tracker.natnet.wire import LARGEST_PACKET, Version
from bench.errors import ConfigError, ConnectError
from bench.simulation.device_clock import DeviceClock
from bench.simulation.natnet.answers import Answers
from bench.simulation.natnet.clients import Address, Clients
from bench.simulation.natnet.packets import APP_VERSIONS, Stamps, make_frame, make_models
from bench.simulation.natnet.timing import RECEIVED_AFTER_S, TRANSMIT_AFTER_S
from bench.simulation.scene import Scene
from bench.simulation.scheduler import Scheduler
from bench.timing import Clock, patience_ns

__all__ = ["NatNetServer"]

FIRST_FRAME_NUMBER = 1042
"""Motive counts from its own start, long before anyone listens."""
NETWORK_S = 0.0006
"""Shortest way from the transmit stamp to the network."""
TAIL_S = 0.00017
"""Mean of what comes on top; together 6.2 ms after mid-exposure at the median and 6.9 ms at 99 %, as in real frames."""
LONGEST_TAIL_S = 0.005
POLL_MS = 20
"""Machine time after which the network thread sees that it should stop."""
JOIN_S = 2.0


class NatNetServer:
    """Simulates OptiTrack Motive, streaming unicast.

    Parameters
    ----------
    host : str
        Address to bind.
    scene : Scene
        Is exposed once a period, on the scheduler's thread, whether or not anyone listens.
    scheduler : Scheduler
        Runs exposures and transmissions.
    clock : Clock
    tracker_clock : DeviceClock
        The clock that Motive's stamps and clock answers are in.
    rate_hz : float
        Exposures in a second of the tracker's clock.
    command_port, data_port : int
        NatNet's ports; unicast uses the first alone.
    version : tuple of int
        NatNet version: 3.0, 3.1, 4.0 or 4.1.
    mid_exposure_known : bool
        False: USB cameras, which send no mid-exposure stamp.
    stamp_delay_s : float
        How much later than the exposure all its stamps say it was.
    seed : int
        Of the packets' delays.
    """

    def __init__(
        self,
        host: str,
        scene: Scene,
        scheduler: Scheduler,
        clock: Clock,
        *,
        tracker_clock: DeviceClock,
        rate_hz: float,
        command_port: int = 1510,
        data_port: int = 1511,
        version: Version = (4, 1, 0, 0),
        mid_exposure_known: bool = True,
        stamp_delay_s: float = 0.0,
        seed: int = 1,
    ) -> None:
        if version[:2] not in APP_VERSIONS:
            known = ", ".join(f"{major}.{minor}" for major, minor in APP_VERSIONS)
            raise ConfigError(f"NatNet {version[0]}.{version[1]} cannot be simulated; the known versions are {known}.")
        self._address = (host, command_port)
        self._scene = scene
        self._scheduler = scheduler
        self._clock = clock
        self._tracker_clock = tracker_clock
        self._rate_hz = rate_hz
        self._stamp_delay_ticks = round(stamp_delay_s * tracker_clock.ticks_per_s)
        self._mid_exposure_known = mid_exposure_known
        self._rng = np.random.default_rng(seed)
        self._clients = Clients(clock)
        info = ServerInfo(
            "Motive (simulated by bench)",
            APP_VERSIONS[version[:2]],
            version,
            round(tracker_clock.ticks_per_s),
            data_port,
        )
        self._answers = Answers(info, make_models(scene), self._clients, rate_hz, self._read_clock)
        self._answers.newest_frame = self._encode_newest
        self._newest: Frame | None = None
        self._socket: socket.socket | None = None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._first_period = 0
        self._last_departure_ns = 0
        self._silent_until_ns = 0
        self.n_exposed = 0
        """Exposures so far."""
        self.n_sent = 0
        """Frame packets handed to the network, over all clients."""
        self.n_unsent = 0
        """Frame packets that the network did not take: its buffer was full."""

    def open(self) -> None:
        """Bind the command port, answer from now on, and expose from the next full period of the tracker's clock.

        Raises
        ------
        ConnectError
            The address is in use, or not ours.
        """
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            link.bind(self._address)
        except OSError as error:
            link.close()
            reason = "is already in use" if error.errno == errno.EADDRINUSE else f"cannot be used: {error.strerror}"
            raise ConnectError(
                f"UDP port {self._address[0]}:{self._address[1]} of the simulated tracker {reason}."
            ) from error
        link.setblocking(False)
        self._socket = link
        self._thread = threading.Thread(target=self._serve, args=(link,), name="natnet-server", daemon=True)
        self._thread.start()
        self._first_period = int(self._read_clock() * self._rate_hz / self._tracker_clock.ticks_per_s) + 1
        self._schedule_exposure()

    def close(self) -> None:
        """Stop answering and sending; what is still scheduled does nothing. May be called twice."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(JOIN_S)
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def stall(self, duration_s: float) -> None:
        """Send and answer nothing for a while of the machine's own time; what was due then never comes. Any thread."""
        self._silent_until_ns = self._clock.now_ns() + patience_ns(self._clock, duration_s)

    @property
    def address(self) -> Address:
        """Host and command port; with port 0 the one that the system chose."""
        if self._socket is None:
            return self._address
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    def _read_clock(self) -> int:
        return self._tracker_clock.ticks_at(self._clock.now_ns())

    def _schedule_exposure(self) -> None:
        period = self._first_period + self.n_exposed
        ticks = round(period * self._tracker_clock.ticks_per_s / self._rate_hz)
        self._scheduler.call_at(self._tracker_clock.host_ns_at(ticks), partial(self._expose, ticks))

    def _expose(self, ticks: int, host_ns: int) -> None:
        if self._stopping.is_set():
            return
        number = FIRST_FRAME_NUMBER + self.n_exposed
        stamps = self._stamp(ticks + self._stamp_delay_ticks)
        exposure = self._scene.expose(number, host_ns)
        timestamp_s = self.n_exposed / self._rate_hz
        frame = make_frame(exposure, number, timestamp_s, stamps, recording=self._answers.is_recording)
        self.n_exposed += 1
        self._scheduler.call_at(self._departure_ns(host_ns), partial(self._transmit, frame))
        self._schedule_exposure()

    def _stamp(self, ticks: int) -> Stamps:
        hz = self._tracker_clock.ticks_per_s
        mid = ticks if self._mid_exposure_known else 0
        return mid, ticks + round(RECEIVED_AFTER_S * hz), ticks + round(TRANSMIT_AFTER_S * hz)

    def _departure_ns(self, exposure_ns: int) -> int:
        """Return when the packet leaves: never before the one that was sent earlier."""
        tail_s = min(self._rng.exponential(TAIL_S), LONGEST_TAIL_S)
        departure_ns = exposure_ns + round((TRANSMIT_AFTER_S + NETWORK_S + tail_s) * 1e9)
        self._last_departure_ns = max(self._last_departure_ns, departure_ns)
        return self._last_departure_ns

    def _transmit(self, frame: Frame, _due_ns: int) -> None:
        self._newest = frame
        packets: dict[Version, bytes] = {}
        for address, version in self._clients.snapshot():
            if version not in packets:
                packets[version] = encode_frame(frame, version)
            if self._send(packets[version], address):
                self.n_sent += 1
            else:
                self.n_unsent += 1

    def _encode_newest(self, version: Version) -> bytes | None:
        return None if self._newest is None else encode_frame(self._newest, version)

    def _send(self, packet: bytes, address: Address) -> bool:
        link = self._socket
        if link is None or self._stopping.is_set() or self._clock.now_ns() < self._silent_until_ns:
            return False
        try:
            link.sendto(packet, address)
        except OSError:
            return False
        return True

    def _serve(self, link: socket.socket) -> None:
        poll = select.poll()
        poll.register(link, select.POLLIN)
        while not self._stopping.is_set():
            if poll.poll(POLL_MS):
                self._answer_one(link)
            self._clients.drop_silent()

    def _answer_one(self, link: socket.socket) -> None:
        try:
            packet, sender = link.recvfrom(LARGEST_PACKET)
        except OSError:
            return
        reply = self._answers.answer(packet, sender)
        if reply is not None:
            self._send(reply, sender)
