"""A simulated controller behind real sockets, a scripted one for faults, and a sink that can be waited on."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest

from bench.config import RobotConfig
from bench.drivers.base import ProgramControl
from bench.drivers.robot.ur.codec import (
    FrameSplitter,
    decode_input_setup,
    decode_output_setup,
    encode_accepted,
    encode_controller_version,
    encode_frame,
    encode_setup_reply,
)
from bench.model import LogEntry, RobotState
from bench.simulation.device_clock import DeviceClock
from bench.simulation.program import PathProgram
from bench.simulation.scheduler import Scheduler
from bench.simulation.ur import UrController
from bench.simulation.ur.variables import INPUT_TYPES, OUTPUT_TYPES
from bench.timing import RunClock

PATIENCE_S = 10.0


class Collector:
    """A record sink; `wait_for` returns when what has arrived satisfies a condition."""

    def __init__(self):
        self.records = []
        self._arrived = threading.Condition()

    def __call__(self, record):
        with self._arrived:
            self.records.append(record)
            self._arrived.notify_all()

    def wait_for(self, condition):
        with self._arrived:
            assert self._arrived.wait_for(condition, PATIENCE_S), f"not so after {len(self.records)} records"

    @property
    def samples(self):
        return [record for record in self.records if isinstance(record, RobotState)]

    @property
    def logs(self):
        return [record for record in self.records if isinstance(record, LogEntry)]


class Losses:
    """An `on_lost` callback that can be waited on."""

    def __init__(self):
        self.errors = []
        self._called = threading.Event()

    def __call__(self, error):
        self.errors.append(error)
        self._called.set()

    def wait(self):
        assert self._called.wait(PATIENCE_S), "no loss was reported"
        return self.errors[0]


@pytest.fixture
def sink() -> Collector:
    return Collector()


@pytest.fixture
def losses() -> Losses:
    return Losses()


@pytest.fixture
def clock() -> RunClock:
    return RunClock.start(speed=4.0)


@pytest.fixture
def make_config() -> Callable[..., RobotConfig]:
    def make(host, **keys):
        return RobotConfig(host=host, program="bend_test.urp", **{"rate_hz": 125.0, **keys})

    return make


@pytest.fixture
def open_program(clock, make_config, request) -> Iterator[Callable[..., ProgramControl]]:
    """Open program controls of the module's kind, which are closed at the end whatever happens."""
    controls = []

    def start(host=None, **keys):
        control = request.module.CONTROL(make_config(host or request.module.HOST), clock, **keys)
        controls.append(control)
        control.open()
        return control

    yield start
    for control in controls:
        control.close()


@pytest.fixture
def start_controller(clock) -> Iterator[Callable[..., UrController]]:
    """Start simulated controllers, ticking at 125 Hz, and stop them afterwards."""
    scheduler = Scheduler(clock)
    controllers = []

    def start(host, *, cycle_s=0.4, **keys):
        controller_clock = DeviceClock(clock.now_ns(), 61_250_000_000, 1e9, drift_ppm=30.0)
        program = PathProgram(cycle_s=cycle_s)
        controller = UrController(
            host, program, scheduler, clock, controller_clock=controller_clock, rate_hz=125.0, **keys
        )
        controller.open()
        controllers.append(controller)
        return controller

    thread = threading.Thread(target=scheduler.run)
    thread.start()
    yield start
    for controller in controllers:
        controller.close()
    scheduler.stop()
    thread.join()


class ScriptedServer:
    """Accepts connections on a port and lets a function have each of them, one after the other."""

    def __init__(self, host, handlers, port=0):
        self._listener = socket.create_server((host, port))
        self.port = self._listener.getsockname()[1]
        self._links = []
        self._thread = threading.Thread(target=self._run, args=(handlers,))
        self._thread.start()

    def _run(self, handlers):
        for handler in handlers:
            try:
                link, _ = self._listener.accept()
            except OSError:
                return
            self._links.append(link)
            with suppress(OSError):
                handler(link)

    def close(self):
        for end in (self._listener, *self._links):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        for end in (self._listener, *self._links):
            end.close()


@pytest.fixture
def scripted() -> Iterator[Callable[..., ScriptedServer]]:
    """Start servers that behave as a function says."""
    servers = []

    def start(host, *handlers, port=0):
        servers.append(ScriptedServer(host, handlers, port))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


class RtdeScript:
    """A controller that answers the handshake as told, then does `after(link, names, types)`."""

    def __init__(self, *, unknown=(), in_use=False, starts=True, protocol=True, version=(5, 26, 0, 0), after=None):
        self.unknown = unknown
        self.in_use = in_use
        self.starts = starts
        self.protocol = protocol
        self.version = version
        self.after = after
        self.before_start = None
        self.rate_hz = None
        self.asked = []
        self.written = []

    def __call__(self, link):
        splitter = FrameSplitter()
        while data := link.recv(65536):
            for kind, payload in splitter.feed(data):
                self._answer(link, chr(kind), payload)

    def _answer(self, link, kind, payload):
        if kind == "V":
            self._send(link, kind, encode_accepted(self.protocol))
        elif kind == "v":
            self._send(link, kind, encode_controller_version(self.version))
        elif kind == "O":
            self.rate_hz, self.names = decode_output_setup(payload, 2)
            self.asked.append(self.names)
            self.types = ["NOT_FOUND" if name in self.unknown else OUTPUT_TYPES[name] for name in self.names]
            self._send(link, kind, encode_setup_reply(1, self.types))
        elif kind == "I":
            types = ["IN_USE" if self.in_use else INPUT_TYPES[name] for name in decode_input_setup(payload)]
            self._send(link, kind, encode_setup_reply(1, types))
        elif kind == "U":
            self.written.append(int.from_bytes(payload[1:], "big"))
        elif kind == "S":
            if self.before_start:
                self.before_start(link, self.names, self.types)
            self._send(link, kind, encode_accepted(self.starts))
            if self.after:
                self.after(link, self.names, self.types)

    def _send(self, link, kind, payload):
        link.sendall(encode_frame(ord(kind), payload))


@pytest.fixture
def rtde_script() -> type[RtdeScript]:
    return RtdeScript
