"""Qualisys Track Manager on the wire: exposures at exact periods of its own clock, frames to every client that asks."""

from __future__ import annotations

import threading
from functools import partial

import numpy as np

from bench.simulation.device_clock import DeviceClock
from bench.simulation.natnet.timing import TAIL_S
from bench.simulation.network import ServerThread
from bench.simulation.outbox import Outbox
from bench.simulation.qualisys.packets import PacketType, encode, encode_components, encode_frame, encode_settings
from bench.simulation.qualisys.session import QtmSession
from bench.simulation.scene import Exposure, Scene
from bench.simulation.scheduler import Scheduler
from bench.timing import Clock, patience_ns

__all__ = ["QualisysServer"]

LATENCY_S = 0.006
"""From the exposure to the packet; the same order as measured on another tracker, for QTM's own is not published."""
LONGEST_TAIL_S = 0.005
CUT_OFF_S = 10.0
"""A client that does not read for so long is cut off."""


class QualisysServer:
    """Simulates Qualisys Track Manager during a measurement.

    Parameters
    ----------
    host, port : str, int
        Address to serve: QTM's little-endian port.
    scene : Scene
        Is exposed once a period, on the scheduler's thread, whether or not anyone listens.
    scheduler : Scheduler
        Runs exposures and transmissions.
    clock : Clock
    tracker_clock : DeviceClock
        Microseconds since the measurement began.
    rate_hz : float
        Exposures in a second of the tracker's clock.
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
        port: int = 22223,
        seed: int = 1,
    ) -> None:
        self.rate_hz = rate_hz
        self._host, self._port = host, port
        self._scene = scene
        self._scheduler = scheduler
        self._clock = clock
        self._tracker_clock = tracker_clock
        self._rng = np.random.default_rng(seed)
        self._network = ServerThread(patience_ns(clock, CUT_OFF_S), what="tracker")
        self._sessions: list[QtmSession] = []
        self._lock = threading.Lock()
        self._newest: tuple[int, int, dict[int, bytes]] | None = None
        self._n_exposed = 0
        self._first_period = 0
        self._last_departure_ns = 0
        self._silent_until_ns = 0
        self._stopping = threading.Event()

    def open(self) -> None:
        """Serve from now on. `ConnectError` if the port is in use, or the address not ours."""
        self._network.listen(self._host, self._port, self._welcome)
        self._network.start()
        self._first_period = int(self._read_clock() * self.rate_hz / self._tracker_clock.ticks_per_s) + 1
        self._schedule_exposure()

    def close(self) -> None:
        """Stop answering and sending; what is still scheduled does nothing. May be called twice."""
        self._stopping.set()
        self._network.close()

    def stall(self, duration_s: float) -> None:
        """Send no frames for a while of the machine's own time; what was due then never comes. Any thread."""
        self._silent_until_ns = self._clock.now_ns() + patience_ns(self._clock, duration_s)

    def drop_clients(self) -> None:
        """Close every connection, as when QTM is closed and opened again. Any thread."""
        self._network.call(partial(self._network.drop_clients, abruptly=False))

    def settings(self, version: str) -> bytes:
        """Return the packet with the settings."""
        return encode_settings(version, self.rate_hz, self._scene.bodies)

    def newest(self, wanted: tuple[int, ...]) -> bytes:
        """Return the packet of the newest frame, or the one that says that there is none."""
        if self._newest is None:
            return encode(PacketType.NO_MORE_DATA, b"")
        ticks, number, components = self._newest
        return encode_frame(ticks, number, components, wanted)

    def _welcome(self, outbox: Outbox) -> QtmSession:
        session = QtmSession(outbox, self, self._leave)
        with self._lock:
            self._sessions.append(session)
        return session

    def _leave(self, session: QtmSession) -> None:
        with self._lock:
            self._sessions.remove(session)

    def _read_clock(self) -> int:
        return self._tracker_clock.ticks_at(self._clock.now_ns())

    def _schedule_exposure(self) -> None:
        ticks = round((self._first_period + self._n_exposed) * self._tracker_clock.ticks_per_s / self.rate_hz)
        self._scheduler.call_at(self._tracker_clock.host_ns_at(ticks), partial(self._expose, ticks))

    def _expose(self, ticks: int, host_ns: int) -> None:
        if self._stopping.is_set():
            return
        self._n_exposed += 1
        exposure = self._scene.expose(self._n_exposed, host_ns)
        tail_s = min(self._rng.exponential(TAIL_S), LONGEST_TAIL_S)
        departure_ns = host_ns + round((LATENCY_S + tail_s) * 1e9)
        self._last_departure_ns = max(self._last_departure_ns, departure_ns)
        self._scheduler.call_at(self._last_departure_ns, partial(self._transmit, ticks, self._n_exposed, exposure))
        self._schedule_exposure()

    def _transmit(self, ticks: int, number: int, exposure: Exposure, _due_ns: int) -> None:
        now_ns = self._clock.now_ns()
        if self._stopping.is_set() or now_ns < self._silent_until_ns:
            return
        components = encode_components(exposure, self._scene.bodies)
        self._newest = ticks, number, components
        with self._lock:
            sessions = [one for one in self._sessions if one.wanted and number % one.divisor == 0]
        packets: dict[tuple[int, ...], bytes] = {}
        for session in sessions:
            wanted = session.wanted
            if wanted and wanted not in packets:
                packets[wanted] = encode_frame(ticks, number, components, wanted)
            if wanted:
                session.outbox.send_package(packets[wanted], now_ns)
