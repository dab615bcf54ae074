"""A simulated Modbus controller in this process, and what a driver says of it."""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from bench.config import ModbusRobotConfig, parse_config
from bench.drivers.robot.modbus import ModbusProgram, ModbusStateStream
from bench.errors import LinkLostError
from bench.model import LogEntry, Record, RobotState
from bench.simulation.device_clock import DeviceClock
from bench.simulation.modbus import ModbusController
from bench.simulation.program import PathProgram
from bench.simulation.scheduler import Scheduler
from bench.timing import RunClock

SIMULATED = (Path(__file__).parents[3] / "bench_configs" / "modbus_simulated.toml").read_text(encoding="utf-8")
PATIENCE_S = 10.0
LOOPBACK = f"127.{os.getpid() % 200 + 1}.62"
"""Of this process alone: two runs of the tests on one machine do not meet."""
SPEED = 4.0

_hosts = itertools.count(1)


def make_config(*changes: tuple[str, str]) -> ModbusRobotConfig:
    """Return the simulated register map on an address of its own, with replacements made."""
    text = SIMULATED
    for old, new in [("127.0.0.61", f"{LOOPBACK}.{next(_hosts)}"), *changes]:
        assert old in text, f"{old!r} is not in the simulated configuration"
        text = text.replace(old, new)
    # a command that is acknowledged may be short: it stands until it is
    text = text.replace('type = "bool", ack = {', 'type = "bool", pulse_s = 0.02, ack = {')
    robot = parse_config(text, "modbus.toml").robot
    assert isinstance(robot, ModbusRobotConfig)
    return robot


@contextmanager
def controller_of(config: ModbusRobotConfig, clock: RunClock, cycle_s: float = 0.5) -> Iterator[ModbusController]:
    scheduler = Scheduler(clock)
    program = PathProgram(config.program, cycle_s=cycle_s)
    device_clock = DeviceClock(clock.now_ns(), 61_250_000_000, 1e9, 25.0)
    controller = ModbusController(config, program, scheduler, clock, controller_clock=device_clock)
    controller.open()
    thread = threading.Thread(target=scheduler.run, name="scheduler", daemon=True)
    thread.start()
    try:
        yield controller
    finally:
        scheduler.stop()
        thread.join()
        controller.close()


@dataclass
class Seen:
    """What a stream said."""

    records: list[Record] = field(default_factory=list)
    missed: list[int] = field(default_factory=list)
    lost: list[LinkLostError] = field(default_factory=list)
    restored: int = 0

    def count_restored(self) -> None:
        self.restored += 1

    @property
    def states(self) -> list[RobotState]:
        return [record for record in list(self.records) if isinstance(record, RobotState)]

    @property
    def texts(self) -> list[str]:
        return [record.text for record in list(self.records) if isinstance(record, LogEntry)]


@dataclass
class Rig:
    """A controller, its clock, and driver objects made for it."""

    config: ModbusRobotConfig
    clock: RunClock
    controller: ModbusController
    seen: Seen = field(default_factory=Seen)

    def make_stream(self, reconnect_s: float = 0.0, silence_s: float = 0.4) -> ModbusStateStream:
        seen = self.seen
        return ModbusStateStream(
            self.config.model_copy(update={"silence_s": silence_s}),
            self.clock,
            on_missed=lambda _topic, n: seen.missed.append(n),
            on_lost=seen.lost.append,
            on_restored=seen.count_restored,
            reconnect_s=reconnect_s,
        )

    @contextmanager
    def streaming(self, reconnect_s: float = 0.0, silence_s: float = 0.4) -> Iterator[ModbusStateStream]:
        stream = self.make_stream(reconnect_s, silence_s)
        stream.open(self.seen.records.append)
        try:
            yield stream
        finally:
            stream.close()

    @contextmanager
    def commanding(self) -> Iterator[ModbusProgram]:
        program = ModbusProgram(self.config, self.clock)
        program.open()
        try:
            yield program
        finally:
            program.close()


@contextmanager
def rig(*changes: tuple[str, str], cycle_s: float = 0.5) -> Iterator[Rig]:
    config, clock = make_config(*changes), RunClock.start(SPEED)
    with controller_of(config, clock, cycle_s) as controller:
        yield Rig(config, clock, controller)


def wait_until(condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain: {what}"
        time.sleep(0.002)
