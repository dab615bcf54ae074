"""A simulated tracker that shows a known scene, with its scheduler running."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from bench.config import SimulationConfig
from bench.drivers.tracker.natnet.wire import LARGEST_PACKET, split_packet
from bench.model import RigidBody
from bench.simulation.device_clock import DeviceClock
from bench.simulation.natnet import NatNetServer
from bench.simulation.scene import Exposure
from bench.simulation.scheduler import Scheduler
from bench.timing import Clock, ManualClock, RunClock

TICKS_PER_S = 3_312_787.0
TICKS_AT_START = 1_416_497_730_518
DRIFT_PPM = -42.0
PATIENCE_S = 20.0


class FakeScene:
    """Random points, remembered by frame number: a clamp's three markers, and others."""

    def __init__(self, n_points: int = 12) -> None:
        self.bodies = {4: ("clamp", np.arange(9.0).reshape(3, 3))}
        self.exposures: dict[int, Exposure] = {}
        self.host_ns: dict[int, int] = {}
        self._n = n_points
        self._rng = np.random.default_rng(7)

    def expose(self, frame_number: int, host_ns: int) -> Exposure:
        ids = np.arange(50_001, 50_001 + self._n, dtype=np.uint32)
        ids[:3] = (4 << 16) | np.arange(1, 4)
        flags = np.full(self._n, 0x12, dtype=np.uint32)
        flags[:3] = 0x0A
        exposure = Exposure(
            self._rng.normal(size=(self._n, 3)).astype(np.float32),
            ids,
            flags,
            np.full(self._n, 0.01, dtype=np.float32),
            self._rng.uniform(0.0002, 0.0007, self._n).astype(np.float32),
            (RigidBody(4, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0), 0.0005),),
        )
        self.host_ns[frame_number] = host_ns
        self.exposures[frame_number] = exposure
        return exposure


def make_server(
    host: str, scene: FakeScene, scheduler: Scheduler, clock: Clock, tracker_clock: DeviceClock, **options: object
) -> NatNetServer:
    """Make a server; ports as it takes them, everything else as [simulation] has it."""
    ports = {"command_port": 0} | {name: options.pop(name) for name in ("command_port", "data_port") if name in options}
    simulation = SimulationConfig(**options)
    return NatNetServer(host, scene, scheduler, clock, tracker_clock=tracker_clock, simulation=simulation, **ports)


class SimulatedTracker:
    """A server, its scheduler and its scene."""

    def __init__(self, host: str, clock: Clock, **options: object) -> None:
        self.clock = clock
        self.scheduler = Scheduler(clock)
        self.scene = FakeScene()
        self.tracker_clock = DeviceClock(clock.now_ns(), TICKS_AT_START, TICKS_PER_S, DRIFT_PPM)
        self.server = make_server(host, self.scene, self.scheduler, clock, self.tracker_clock, **options)


@contextmanager
def running_tracker(host: str, speed: float = 1.0, **options: object) -> Iterator[SimulatedTracker]:
    tracker = SimulatedTracker(host, RunClock.start(speed), **options)
    tracker.server.open()
    thread = threading.Thread(target=tracker.scheduler.run)
    thread.start()
    try:
        yield tracker
    finally:
        tracker.scheduler.stop()
        thread.join()
        tracker.server.close()


class StillTracker(SimulatedTracker):
    """Its clock moves when the test lets it, and exposures happen then, on the test's thread."""

    def __init__(self, host: str, **options: object) -> None:
        super().__init__(host, ManualClock(), **options)

    def let_pass(self, seconds: float) -> None:
        end_ns = self.clock.now_ns() + round(seconds * 1e9)
        self.scheduler.call_at(end_ns, lambda _due_ns: self.scheduler.stop())
        self.scheduler._stopped.clear()
        self.scheduler.run()


@contextmanager
def still_tracker(host: str, **options: object) -> Iterator[StillTracker]:
    tracker = StillTracker(host, **options)
    tracker.server.open()
    try:
        yield tracker
    finally:
        tracker.server.close()


class RawClient:
    """A socket that sends bytes and reads messages."""

    def __init__(self, server: tuple[str, int]) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.32.1", 0))
        self.socket.settimeout(PATIENCE_S)
        self._server = server

    def __enter__(self) -> RawClient:
        return self

    def __exit__(self, *_error: object) -> None:
        self.socket.close()

    def send(self, packet: bytes) -> None:
        self.socket.sendto(packet, self._server)

    def receive(self) -> tuple[int, bytes]:
        return split_packet(self.socket.recv(LARGEST_PACKET))

    def ask(self, packet: bytes) -> tuple[int, bytes]:
        self.send(packet)
        return self.receive()

    def hears_nothing(self) -> bool:
        """Tell whether nothing waits. What was sent on loopback before this call has arrived."""
        self.socket.setblocking(False)
        try:
            self.socket.recv(LARGEST_PACKET)
        except BlockingIOError:
            return True
        finally:
            self.socket.settimeout(PATIENCE_S)
        return False
