"""Every robot and tracker the roles are asked of, each behind the same few words."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from bench.config import AnyRobotConfig, AnyTrackerConfig, QualisysConfig, RobotConfig, TrackerConfig
from bench.drivers.robot import make_program_control, make_state_stream
from bench.drivers.tracker import make_tracker
from bench.errors import BenchError
from bench.model import RobotState
from bench.simulation.device_clock import DeviceClock
from bench.simulation.program import PathProgram
from bench.simulation.scheduler import Scheduler
from bench.simulation.ur import KINDS, UrController
from bench.timing import ManualClock, RunClock

for room in ("run", "simulation/natnet", "simulation/qualisys", "drivers/robot"):
    sys.path.insert(0, str(Path(__file__).parents[1] / room))

from fake_robot import FakeRobot  # noqa: E402 - found by the path above
from modbus_bench import controller_of, make_config  # noqa: E402
from natnet_bench import running_tracker  # noqa: E402
from qualisys_bench import running_qtm  # noqa: E402

PROGRAM = "bend_test.urp"
ROBOT_HOSTS = {"e-series": "127.0.63.11", "cb3": "127.0.63.12", "polyscope-x": "127.0.63.13"}
TRACKER_HOST, QTM_HOST = "127.0.63.21", "127.0.63.22"
PATIENCE_S = 60.0
"""Machine time; a real robot's cycle must fit into it."""
SPEED = 4.0


class Collector:
    """A record sink; `wait_for` returns when what has arrived satisfies a condition."""

    def __init__(self) -> None:
        self.records: list[Any] = []
        self._arrived = threading.Condition()

    def __call__(self, record: Any) -> None:
        with self._arrived:
            self.records.append(record)
            self._arrived.notify_all()

    def wait_for(self, condition: Callable[[], object]) -> None:
        with self._arrived:
            assert self._arrived.wait_for(condition, PATIENCE_S), f"not so after {len(self.records)} records"

    def of(self, kind: type) -> list[Any]:
        with self._arrived:
            return [record for record in self.records if isinstance(record, kind)]


class RobotRig:
    """A robot in both its roles."""

    def __init__(self, config: AnyRobotConfig, clock: RunClock) -> None:
        self.program = config.program
        self.is_register_map = config.kind == "modbus"
        """It is polled, and its programs have numbers where others have names."""
        self.sink = Collector()
        self.n_missed = 0
        self.stream = make_state_stream(config, clock, on_missed=self._count_missed)
        self._make_control = lambda version: make_program_control(config, clock, controller_version=version)

    def _count_missed(self, _topic: str, n: int) -> None:
        self.n_missed += n

    def open(self) -> Any:
        """Open stream and program control in the order of a run; return what the stream tells of itself."""
        info = self.stream.open(self.sink)
        self.control = self._make_control(info.version)
        self.control.open()
        return info

    @property
    def states(self) -> list[RobotState]:
        return self.sink.of(RobotState)

    def wait_for(self, condition: Callable[[], object]) -> None:
        self.sink.wait_for(condition)

    def wait_for_state(self, condition: Callable[[RobotState], object]) -> None:
        """Wait until a state that arrives from now on satisfies a condition."""
        n = len(self.states)
        self.wait_for(lambda: any(condition(state) for state in self.states[n:]))

    def next_states(self, count: int) -> list[RobotState]:
        n = len(self.states)
        self.wait_for(lambda: len(self.states) >= n + count)
        return self.states[n : n + count]

    def start(self) -> None:
        """Load and play the program, with no cycle granted."""
        self.stream.grant_cycles(0)
        self.control.load(self.program)
        self.control.play()
        self.wait_for_state(lambda state: state.runtime_state == 2 and state.cycle_count == 0)

    def close(self) -> None:
        """Leave the robot standing, whatever the test did."""
        for step in (lambda: self.control.stop(), lambda: self.stream.grant_cycles(0)):
            with suppress(BenchError, AttributeError):
                step()
        if hasattr(self, "control"):
            self.control.close()
        self.stream.close()


class FakeControl:
    """The fake robot's program control alone: its `open` takes no sink."""

    def __init__(self, robot: FakeRobot) -> None:
        self.check, self.load, self.play = robot.check, robot.load, robot.play
        self.stop, self.close = robot.stop, robot.close
        self.ready_when = robot.ready_when

    def open(self) -> None:
        """There is nothing to connect."""


class FakeRig(RobotRig):
    """The robot of the tests of `bench.run`, whose time passes when somebody waits."""

    def __init__(self) -> None:
        self.program = PROGRAM
        self.is_register_map = False
        self.sink = Collector()
        self.n_missed = 0
        self.stream = self._robot = FakeRobot(ManualClock())
        self._make_control = lambda _version: FakeControl(self._robot)

    def wait_for(self, condition: Callable[[], object]) -> None:
        for _ in range(1000):
            if condition():
                return
            self._robot.advance()
        raise AssertionError(f"not so after {len(self.states)} states")


@contextmanager
def simulated_robot(kind: str) -> Iterator[RobotRig]:
    clock = RunClock.start(speed=SPEED)
    scheduler = Scheduler(clock)
    controller = UrController(
        ROBOT_HOSTS[kind],
        PathProgram(PROGRAM, cycle_s=0.4),
        scheduler,
        clock,
        controller_clock=DeviceClock(clock.now_ns(), 61_250_000_000, 1e9, drift_ppm=30.0),
        rate_hz=125.0,
        kind=KINDS[kind],
    )
    controller.open()
    thread = threading.Thread(target=scheduler.run)
    thread.start()
    try:
        yield RobotRig(RobotConfig(host=ROBOT_HOSTS[kind], program=PROGRAM, rate_hz=125.0), clock)
    finally:
        controller.close()
        scheduler.stop()
        thread.join()


@contextmanager
def modbus_robot() -> Iterator[RobotRig]:
    clock, config = RunClock.start(speed=SPEED), make_config()
    with controller_of(config, clock):
        yield RobotRig(config, clock)


@contextmanager
def fake_robot() -> Iterator[RobotRig]:
    yield FakeRig()


@contextmanager
def real_robot(host: str, program: str) -> Iterator[RobotRig]:
    yield RobotRig(RobotConfig(host=host, program=program, rate_hz=125.0), RunClock.start())


class TrackerRig:
    """A tracker in its role."""

    def __init__(self, config: AnyTrackerConfig, clock: RunClock) -> None:
        self.sink = Collector()
        self.stream = make_tracker(config, clock)


@contextmanager
def simulated_tracker() -> Iterator[TrackerRig]:
    with running_tracker(TRACKER_HOST, SPEED, command_port=1510) as tracker:
        yield TrackerRig(TrackerConfig(host=TRACKER_HOST), tracker.clock)


@contextmanager
def simulated_qtm() -> Iterator[TrackerRig]:
    with running_qtm(QTM_HOST, SPEED) as qtm:
        yield TrackerRig(QualisysConfig(host=QTM_HOST), qtm.clock)


@contextmanager
def real_tracker(host: str) -> Iterator[TrackerRig]:
    yield TrackerRig(TrackerConfig(host=host), RunClock.start())
